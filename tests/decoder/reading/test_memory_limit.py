"""--max-memory holds for pictures: tile lists, lens tables, expanded pictures; from files, pipes and while followed."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.packets.syntax import write_key
from decogs.codec.scene.lattice import default_lattice, quantise
from decogs.decoder import decode, info
from decogs.decoder.reading.stream import open_stream
from decogs.decoder.rendering.views import render_view
from decogs.formats.cameras import Camera
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.splats import Splats
from decogs.formats.stream.container import PacketKind, StreamWriter

LENS = ("opencv", (-0.1, 0.0, 0.0, 0.0))


def write_covering(path: Path, count: int, side: int, *lens, focal: float = 1.0) -> Path:
    """``count`` Gaussians in a stream of some hundred bytes, each of which covers the whole picture."""
    camera = Camera("a", side, side, focal * side, focal * side, side / 2, side / 2, np.eye(4), *lens)
    lattice = default_lattice(2.0)
    values = (
        np.tile([0, 0, 8.0], (count, 1)),
        np.full((count, 3), np.log(3.0)),
        np.tile([1.0, 0, 0, 0], (count, 1)),
        np.full(count, -4.0),
        np.zeros((count, 1, 3)),
    )
    scene = Splats(*(np.ascontiguousarray(value, np.float32) for value in values))
    state, _ = keyframe_state(quantise(scene, lattice))
    with path.open("wb") as file:
        writer = StreamWriter(file, StreamHeader(cameras=(camera,), lattice=lattice).to_bytes())
        writer.write(PacketKind.KEY, 0, write_key(state).payload)
        writer.finish()
    return path


PROGRAM = """
import re, sys
from pathlib import Path
import cv2, OpenEXR
import decogs.decoder.decoding, decogs.decoder.rendering.played_view
from decogs.decoder.rasterise.native import renderer

def peak():
    return int(re.search("VmHWM: *\t* *([0-9]+) kB", Path("/proc/self/status").read_text())[1]) << 10

renderer(1)
stream, output, limit = sys.argv[1:]
before = peak()
decogs.decoder.decoding.decode(stream, output, view="a", max_memory=int(limit), threads=1)
print(peak() - before)
"""


def memory_taken(stream: Path, output: Path, limit: int) -> int:
    """By how much the memory of a process of its own grows at most while it decodes."""
    command = [sys.executable, "-c", PROGRAM, str(stream), str(output), str(limit)]
    return int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def smallest_limit_of_a_file(stream: Path, output: Path, low: int = 1 << 20, high: int = 1 << 30) -> int:
    """The same of a file with layers, which take more than the picture."""
    while high > low * 1.02:
        middle = (low + high) // 2
        try:
            decode(stream, output, view="a", threads=1, max_memory=middle)
            high = middle
        except UsageError:
            low = middle
    return high


def smallest_limit(stream: Path, low: int = 1 << 20, high: int = 1 << 30) -> int:
    """The least memory, to 2 %, with which the first picture is not refused."""
    with open_stream(stream) as opened:
        frame = next(opened.frames())
        while high > low * 1.02:
            middle = (low + high) // 2
            try:
                render_view(opened.header, frame.splats, "a", threads=1, max_memory=middle)
                high = middle
            except UsageError:
                low = middle
    return high


@pytest.mark.parametrize(
    ("count", "side", "lens", "focal", "kind"),
    [(6000, 240, (), 1.0, "png"), (1, 700, (), 1.0, "exr"), (1, 400, LENS, 0.42, "exr")],
    ids=["pairs", "picture", "lens"],
)
def test_what_fits_takes_no_more(tmp_path: Path, count: int, side: int, lens: tuple, focal: float, kind: str) -> None:
    """At the smallest limit that lets a picture through; the floor is what shows that the limit is what is counted."""
    stream = write_covering(tmp_path / "s.dgs", count, side, *lens, focal=focal)
    limit = smallest_limit(stream) if kind == "png" else smallest_limit_of_a_file(stream, tmp_path / "first.exr")
    taken = memory_taken(stream, tmp_path / f"o.{kind}", limit)
    assert 0.25 * limit < taken < limit, (taken, limit)


@pytest.mark.parametrize("how", ["file", "pipe", "followed"])
def test_what_does_not_fit_is_refused_before_it_is_drawn(tmp_path: Path, how: str) -> None:
    """1 kB of stream: tile lists of some gigabytes, a picture of 1 GB, lens tables of 0.6 GB."""
    for count, side, lens, says in (
        (40_000, 1024, (), "covered too many times .* more memory"),
        (1, 4096, (), "needs more than the memory allowed"),
        (1, 2048, LENS, "needs more than the memory allowed"),
    ):
        path = write_covering(tmp_path / "s.dgs", count, side, *lens)
        source = io.BytesIO(path.read_bytes()) if how == "pipe" else path
        with pytest.raises(UsageError, match=says):
            decode(
                source, tmp_path / "o", view="a", max_memory=256 << 20, follow=how == "followed", idle=0.1, threads=1
            )
        assert not (tmp_path / "o").exists()


def test_pairs_are_counted_where_a_few_change(tmp_path: Path) -> None:
    """An incremental view refuses a change that brings too many, and must be given its scene anew afterwards."""
    from decogs.decoder.rasterise.incremental_view import IncrementalView

    with open_stream(write_covering(tmp_path / "s.dgs", 40, 64)) as opened:
        scene, camera = next(opened.frames()).splats, opened.header.cameras[0]
    view, nothing = IncrementalView(camera, (0, 0, 0), threads=1), np.zeros(0, np.int64)
    view.allow(16 * 60)
    view.set_scene(scene)
    with pytest.raises(UsageError, match=r"64x64 is covered too many times .* \(`max_memory`\)"):
        view.change(nothing, scene, np.arange(40, 80), population=80)
    with pytest.raises(ValueError, match="place one first"):
        view.redraw()
    view.set_scene(scene)
    assert view.redraw() == 16
    view.allow(16 * 39)
    with pytest.raises(UsageError, match="covered too many times"):
        view.set_scene(scene)


def test_a_limit_that_follows_from_the_memory_says_so(small_stream) -> None:
    with pytest.raises(StreamError, match=r"above the limit of 0 .*; allow more memory than 1 bytes \(`max_memory`\)"):
        info(small_stream.path, max_memory=1)
    with pytest.raises(StreamError, match=r"60 Gaussians are above the limit of \d+ .*`max_memory`"):
        info(small_stream.path, max_memory=64_000)
    with (
        open_stream(small_stream.path, max_gaussians=7) as stream,
        pytest.raises(StreamError, match="limit of 7") as caught,
    ):
        list(stream.frames())
    assert "max_memory" not in str(caught.value)
