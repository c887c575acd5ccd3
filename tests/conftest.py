"""What holds for all tests: FFmpeg is quiet, and Hypothesis has no deadlines.

FFmpeg's level is looked up once, by whoever opens or makes the first video: in a test, that may be the test. Deadlines
would measure the machine and what else it does, not the code.
"""

from __future__ import annotations

import contextlib
import os

os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

with contextlib.suppress(ImportError):  # the wheel is checked in an environment without it
    import hypothesis

    hypothesis.settings.register_profile("decogs", deadline=None)
    hypothesis.settings.load_profile("decogs")
