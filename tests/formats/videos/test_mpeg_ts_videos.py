"""MPEG-TS, which has no list of keyframes and may change its size."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from decogs.formats.errors import RigError
from decogs.formats.videos.reading import open_video
from textured_videos import X264, texture, write


@pytest.mark.parametrize("start", [8, 16, 23, 31])
def test_a_seek_that_ends_between_keyframes_shows_no_frame_without_its_reference(tmp_path: Path, start: int) -> None:
    """MPEG-TS has no list of keyframes, and the decoder of MPEG-4 shows what it cannot know as grey."""
    write(tmp_path / "a.ts", "mpeg4", frames=36, kind="mpegts", options={"bf": "2", "g": "12", "b": "4M"})
    source = open_video(tmp_path / "a.ts")
    frames = list(source.read(0, 36))
    np.testing.assert_array_equal(list(source.read(start, 36)), frames[start:])


def test_a_size_that_changes_is_found_when_the_video_is_opened(tmp_path: Path) -> None:
    with av.open(str(tmp_path / "a.ts"), "w") as container:
        container_stream = container.add_stream("libx264", rate=25, options=X264 | {"bf": "0"})
        container_stream.width, container_stream.height, container_stream.pix_fmt = 64, 48, "yuv420p"
        for part, size in enumerate([(64, 48), (96, 64)]):
            coder = av.CodecContext.create("libx264", "w")
            coder.width, coder.height, coder.pix_fmt, coder.options = *size, "yuv420p", X264 | {"bf": "0"}
            coder.time_base = Fraction(1, 25)
            for t in range(12):
                frame = av.VideoFrame.from_ndarray(texture(size), format="rgb24").reformat(format="yuv420p")
                frame.pts = 12 * part + t
                for packet in coder.encode(frame):
                    packet.stream = container_stream
                    container.mux(packet)
            for packet in coder.encode():
                packet.stream = container_stream
                container.mux(packet)
    with pytest.raises(RigError, match=r"a\.ts: frame 12 is 96 x 64 pixels, the video started with 64 x 48"):
        open_video(tmp_path / "a.ts")
