"""The decoder works without torch and without the encoder: both are made impossible to import."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

PROGRAM = """
import sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name == "torch" or name.startswith(("torch.", "decogs.encoder")):
            raise ImportError(f"{name} is blocked")

sys.meta_path.insert(0, Blocked())
for blocked in ("torch", "decogs.encoder"):
    try:
        __import__(blocked)
    except ImportError:
        pass
    else:
        sys.exit(f"{blocked} is not blocked")

stream, folder = sys.argv[1:]
from decogs.decoder import decode, export, info, open_stream, render_view

with open_stream(stream) as opened:
    frames = list(opened.frames(3))
    picture = render_view(opened.header, frames[0].splats, "wide")
assert picture.image.max() > 0.5, "nothing is seen"
decode(stream, folder + "/pictures", view="cam01")
decode(stream, folder + "/video.mp4", view="cam00")
decode(stream, folder + "/frame.exr", view="cam00", frames=slice(2, 3))
export(stream, folder + "/scene.usda", frames=slice(0, 2))
assert info(stream).totals["frames"] == 8
from decogs.decoder.commands import decode_main, export_main, info_main
assert info_main([stream]) == 0
from decogs.decoder.editing.commands import edit_main
edits = "trim 1:7 crop sphere 0,0,2 0.5 transform --up Y clean --picture".split()
assert edit_main([stream, "-o", folder + "/edited.dgs", *edits, folder + "/goes.png"]) == 0
assert not [name for name in sys.modules if name == "torch" or name.startswith("decogs.encoder")]
"""

START_UP = """
import sys
from decogs.decoder.commands import info_main
assert info_main([sys.argv[1]]) == 0
from decogs.decoder.editing.commands import edit_main
assert edit_main([sys.argv[1], "--dry-run", "trim", "1:7", "crop", "sphere", "0,0,2", "0.5"]) == 0
print(sorted({"cv2", "OpenEXR", "pxr", "torch", "tqdm", "decogs.decoder.rasterise"} & set(sys.modules)))
"""


def run(program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", program, *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        cwd=Path(__file__).parent,  # The checkout's own decogs would come before what is installed.
    )


def test_the_decoder_runs_without_torch_and_encoder(small_stream, tmp_path: Path) -> None:
    result = run(PROGRAM, str(small_stream.path), str(tmp_path))
    assert result.returncode == 0, result.stderr
    assert len(list((tmp_path / "pictures").glob("cam01_*.png"))) == 8
    for name in ("video.mp4", "frame.exr", "scene.usda", "edited.dgs", "goes.png"):
        assert (tmp_path / name).stat().st_size > 1000


def test_start_up_loads_nothing_heavy(small_stream) -> None:
    """What makes the decoder start in a fraction of a second: these are loaded when they are used, and not before."""
    result = run(START_UP, str(small_stream.path))
    assert result.returncode == 0, result.stderr
    assert result.stdout.splitlines()[-1] == "[]"
