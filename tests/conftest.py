"""What holds for all tests: FFmpeg and progress are quiet, torch has one thread, and Hypothesis has no deadlines.

FFmpeg's level is looked up once, by whoever opens or makes the first video: in a test, that may be the test. Torch, a
reference for small arrays, waits for its threads by spinning: on two busy processors a test of 13 seconds took 207.
Deadlines would measure the machine and what else it does, not the code.
"""

from __future__ import annotations

import contextlib
import math
import os

import pytest

from decogs.formats.cli.progress import Pace

os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
os.environ.setdefault("OMP_NUM_THREADS", "1")

with contextlib.suppress(ImportError):  # the wheel is checked in an environment without it
    import hypothesis

    # A few draws each time; `pytest --hypothesis-profile=thorough` and `make fuzz` take many.
    hypothesis.settings.register_profile("decogs", deadline=None, max_examples=30)
    hypothesis.settings.register_profile("thorough", deadline=None, max_examples=300)
    hypothesis.settings.load_profile("decogs")


@pytest.fixture(autouse=True)
def no_progress_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tests compare what commands say on stderr, and a busy machine would have them say how far they are."""
    monkeypatch.setattr("decogs.formats.cli.progress._PACE", Pace(math.inf, math.inf))
