"""The page that decogs-view serves, in Chromium: its exact picture has the bytes of decogs-decode's, with and without
WebGL2. Needs Node and Chromium."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from decogs.decoder import decode, view
from node import PLAYER, node

ROOT = Path(__file__).parents[2]


FRAMES = (0, 3, 6, 1)


@pytest.fixture
def stream(tmp_path: Path) -> Path:
    """The decoder's small stream: motion, births and deaths; its first camera has no lens."""
    spec = importlib.util.spec_from_file_location("small_streams", ROOT / "tests" / "decoder" / "conftest.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    path: Path = module.write_stream(tmp_path / "small.dgs").path
    return path


def test_exact_pictures_are_those_of_decode(stream: Path, tmp_path: Path) -> None:
    with view(stream, browser=False) as shown:
        script = PLAYER / "tests" / "browser" / "exact.mjs"
        run = subprocess.run(
            [node(), str(script), shown.url, str(tmp_path), *(f"cam00:{frame}" for frame in FRAMES)],
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
    if run.returncode == 3:
        pytest.skip("Chromium is not installed")
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout) == {
        "with": {"exact": True, "canChooseExact": True, "error": None},
        "without": {"exact": True, "canChooseExact": False, "error": None},
        "problems": [],
    }
    decode(stream, tmp_path / "decoded", view="cam00")
    expected = [cv2.imread(str(path)) for path in sorted((tmp_path / "decoded").iterdir())]
    for frame in FRAMES:
        for kind in ("with", "without"):
            drawn = cv2.imread(str(tmp_path / f"{kind}_cam00_{frame}.png"))
            np.testing.assert_array_equal(drawn, expected[frame])
