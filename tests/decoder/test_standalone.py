"""The decoder works without the encoder and what the extras bring, which are made impossible to import."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from decogs.formats.system.extras import install

BLOCKED = """
import sys
blocked = sys.argv.pop(1).split(",")

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if any(name == one or name.startswith(one + ".") for one in blocked):
            raise ModuleNotFoundError(f"{name} is blocked", name=name)

sys.meta_path.insert(0, Blocked())
for one in blocked:
    try:
        __import__(one)
    except ImportError:
        pass
    else:
        sys.exit(f"{one} is not blocked")
"""

BASE = """
stream, folder = sys.argv[1:]
from decogs.decoder import decode, export, info, open_stream, render_view

with open_stream(stream) as opened:
    frames = list(opened.frames(3))
    picture = render_view(opened.header, frames[0].splats, "cam00")
assert picture.image.max() > 0.5, "nothing is seen"
decode(stream, folder + "/pictures", view="cam01", undistorted=True)
decode(stream, folder + "/frame.exr", view="cam00", frames=slice(2, 3))
for name in ("scene.ply", "scene.sog", "scene.glb"):
    export(stream, f"{folder}/{name}", frames=slice(0, 1))
assert info(stream).totals["frames"] == 8
from decogs.decoder.commands import decode_main, export_main, info_main
assert info_main([stream]) == 0
from decogs.decoder.editing.commands import edit_main
edits = "trim 1:7 crop sphere 0,0,2 0.5 transform --up Y clean --picture".split()
assert edit_main([stream, "-o", folder + "/edited.dgs", *edits, folder + "/goes.png"]) == 0
from decogs.decoder import view
from urllib.request import urlopen
with view(stream, browser=False) as served, urlopen(served.url) as page:
    assert b"decogs-player" in page.read()
"""

EXTRAS = """
stream, folder = sys.argv[1:]
from decogs.decoder import decode, export
decode(stream, folder + "/video.mp4", view="wide")  # which has a lens
export(stream, folder + "/scene.usda", frames=slice(0, 2))
"""

MAIN = "from decogs.decoder.commands import {0}_main; sys.exit({0}_main(sys.argv[1:]))"

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


OUR_OWN, OF_EXTRAS = "torch,decogs.encoder", "cv2,av,pxr"


def test_the_base_decodes_exports_edits_and_plays(small_stream, tmp_path: Path) -> None:
    result = run(BLOCKED + BASE, f"{OUR_OWN},{OF_EXTRAS}", str(small_stream.path), str(tmp_path))
    assert result.returncode == 0, result.stderr
    assert len(list((tmp_path / "pictures").glob("cam01_*.png"))) == 8
    for name in ("frame.exr", "scene.ply", "scene.sog", "scene.glb", "edited.dgs", "goes.png"):
        assert (tmp_path / name).stat().st_size > 1000


def test_extras_bring_video_and_usd_without_the_encoder(small_stream, tmp_path: Path) -> None:
    for module in OF_EXTRAS.split(","):
        pytest.importorskip(module, reason="the extras are not installed")
    result = run(BLOCKED + EXTRAS, OUR_OWN, str(small_stream.path), str(tmp_path))
    assert result.returncode == 0, result.stderr
    for name in ("video.mp4", "scene.usda"):
        assert (tmp_path / name).stat().st_size > 1000


@pytest.mark.parametrize(
    ("command", "output", "options", "said"),
    [
        (
            "decode",
            "video.mp4",
            ["--view", "cam00"],
            f"this needs PyAV, which is not installed: {install('video')}",
        ),
        ("export", "scene.usdc", [], f"this needs OpenUSD, which is not installed: {install('usd')}"),
        (
            "decode",
            "x",
            ["--camera", "camera.usda"],
            f"this needs OpenUSD, which is not installed: {install('usd')}",
        ),
        (
            "decode",
            "around.png",
            ["--view", "cam00", "--equirectangular"],
            f"this needs OpenCV, which is not installed: {install('encode')}",
        ),
    ],
)
def test_without_an_extra_a_command_says_which_one(
    small_stream, tmp_path: Path, command: str, output: str, options: list[str], said: str
) -> None:
    (tmp_path / "camera.usda").write_text("#usda 1.0\n")
    options = [str(tmp_path / "camera.usda") if option == "camera.usda" else option for option in options]
    arguments = [str(small_stream.path), "-o", str(tmp_path / output), "--quiet", *options]
    result = run(BLOCKED + MAIN.format(command), OF_EXTRAS, *arguments)
    assert (result.returncode, result.stderr.splitlines()) == (2, [f"decogs-{command}: error: {said}"])
    assert not (tmp_path / output).exists()


@pytest.mark.parametrize(
    ("command", "options", "extra"),
    [
        ("encode", ["{}", "-o", "{}/o.dgs", "--quiet"], "encode"),
        ("pack", ["{}/s_####.ply", "-o", "{}/o.dgs"], "encode"),
        ("join", ["{}/a.part", "-o", "{}/o.dgs"], "encode"),
        ("analyze", ["{}"], "encode"),
        ("sync", ["{}", "-o", "{}/s"], "encode"),
        ("calibrate", ["{}", "-o", "{}/c"], "encode"),
        ("bench", ["rates", "{}", "-o", "{}/r"], "bench"),
    ],
)
def test_what_needs_much_names_the_extra_that_has_all_of_it(
    command: str, options: list[str], extra: str, tmp_path: Path
) -> None:
    program = f"import decogs.entry; sys.exit(decogs.entry.{command}())"
    given = [option.format(tmp_path) for option in options]
    result = run(BLOCKED + program, OF_EXTRAS, *given)
    assert result.returncode == 2
    assert re.fullmatch(rf".*: error: this needs \w+, .*: {re.escape(install(extra))}\n", result.stderr)


def test_start_up_loads_nothing_heavy(small_stream) -> None:
    """What makes the decoder start in a fraction of a second: these are loaded when they are used, and not before."""
    result = run(START_UP, str(small_stream.path))
    assert result.returncode == 0, result.stderr
    assert result.stdout.splitlines()[-1] == "[]"
