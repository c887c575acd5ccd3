"""Videos of a picture that moves, coded as cameras do, for tests that read them."""

from __future__ import annotations

import struct
from fractions import Fraction
from pathlib import Path

import av
import av.filter
import numpy as np

from decogs.formats.videos.reading import VideoSource, open_video

X264 = {"crf": "5", "preset": "ultrafast"}


def texture(size: tuple[int, int]) -> np.ndarray:
    """Smooth colours without a symmetry, (H, W, 3) uint8."""
    columns, rows = np.meshgrid(np.linspace(0, 1, size[0]), np.linspace(0, 1, size[1]))
    shown = np.stack([columns, rows, (columns + 0.3) * (1 - rows)], axis=-1)
    return (30 + 150 * shown / shown.max()).astype(np.uint8)


def write(
    path: Path,
    codec: str = "libx264",
    pixels: str = "yuv420p",
    *,
    frames: int = 6,
    size: tuple[int, int] = (64, 48),
    options: dict[str, str] | None = None,
    kind: str | None = None,
    flagged: range = range(0),
) -> list[np.ndarray]:
    """A video at 25 frames per second, and what went in; ``flagged``: frames with the flag of interlaced ones."""
    shown = [np.roll(texture(size), 3 * t, axis=1) for t in range(frames)]
    with av.open(str(path), "w", format=kind) as container:
        stream = container.add_stream(codec, rate=25, options=X264 if options is None else options)
        stream.width, stream.height, stream.pix_fmt, stream.time_base = *size, pixels, Fraction(1, 25)
        for t, picture in enumerate(shown):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            if t in flagged:
                graph = av.filter.Graph()
                graph.link_nodes(
                    graph.add_buffer(width=size[0], height=size[1], format="rgb24", time_base=Fraction(1, 25)),
                    graph.add("setfield", "tff"),
                    graph.add("buffersink"),
                ).configure()
                graph.push(frame)
                frame = graph.pull()
            frame.pts, frame.time_base = t, Fraction(1, 25)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return shown


def long_video(path: Path, **options: str) -> VideoSource:
    """200 frames of 64x48 that differ, with pictures coded out of order."""
    texture = np.random.default_rng(0).integers(0, 255, (48, 64, 3), np.uint8)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25, options=options)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for number in range(200):
            picture = np.roll(texture, 3 * number, axis=1)
            picture[:8] = number
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
    return open_video(path)


def with_matrix(mp4: bytes, *values: int) -> bytes:
    """The file with a, b, c, d of its track's display matrix replaced. Source: ISO 14496-12, section 8.3.2."""
    at = mp4.index(b"tkhd") + 4 + 40
    a, b, c, d = (value << 16 for value in values)
    return mp4[:at] + struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30) + mp4[at + 36 :]
