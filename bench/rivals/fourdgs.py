"""The rival container .4dgs, of moving Gaussians in keyframes and deltas, by the PyPI package ``fourdgs`` (0.6.0).

Like a stream, it has keyframes, Gaussians with identities, and differences of integers between frames. Its grids are of
the whole clip, and whoever has a value that falls into another of their bins is written again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from decogs.formats.splat_files import Room
from decogs.formats.splat_files.quantised import opacities, unit_rotations
from decogs.formats.splat_sequences.fourdgs import FourDGSFile, has_fourdgs
from decogs.formats.splats import SH_C0, Splats

from .sequences import NO_DIRECTIONS, Frames, Rival, SceneFrame, Sizes

_FRAME_RATE = 30.0
"""Any would do: no Gaussian moves or fades between frames."""
_NEVER_FADES = 1e6
"""Standard deviation of a Gaussian's opacity over time, seconds: the writer takes no infinite one."""
_FILE = "scene.4dgs"


@dataclass(frozen=True)
class FourDGS:
    """All frames in one file.

    ``profile``: bounds of the error, of which positions' are .02, .05 or .2 of the clip's median size of a Gaussian,
    colours' .5, 1 or 3 levels of 255. ``keyframe_every``: frames; None: only the first is one. ``zstd``: its level;
    None: deflate, level 6.
    """

    profile: Literal["fine", "default", "coarse"]
    keyframe_every: int | None = None
    zstd: int | None = 19

    def missing(self) -> str | None:
        return None if has_fourdgs() else "not installed"

    def write(self, frames: Frames, folder: Path) -> Sizes:
        """The first frame's bytes are those before the second frame's: a file can be played from its front on."""
        from fourdgs import keyframe_delta_file as files
        from fourdgs.keyframe_delta_writer import KeyframeDeltaOptions
        from fourdgs.serialization import CODEC_DEFLATE, CODEC_ZSTD

        samples = [_sample(number / _FRAME_RATE, frame) for number, frame in enumerate(frames())]
        data = files.write_sequence(
            samples,
            len(samples) / _FRAME_RATE,
            kd=KeyframeDeltaOptions(keyframe_every=self.keyframe_every or len(samples)),
            profile=self.profile,
            codec=CODEC_DEFLATE if self.zstd is None else CODEC_ZSTD,
            level=6 if self.zstd is None else self.zstd,
        )
        (folder / _FILE).write_bytes(data)
        chunks = files.open_indexed(data).index
        return Sizes(chunks[1].chunk_offset if len(chunks) > 1 else len(data), len(data))

    def read(self, folder: Path) -> Iterator[Splats]:
        return (frame.splats for frame in FourDGSFile(folder / _FILE, Room(), _FRAME_RATE).frames())


def _sample(seconds: float, frame: SceneFrame) -> Any:
    """A frame as the package takes it: linear sizes, quaternions xyzw, colours of SH degree 0 from 0 to 1."""
    from fourdgs import GaussianSet
    from fourdgs.keyframe_delta_writer import Sample

    splats, count = frame.splats, len(frame.splats)
    colours = np.clip(splats.sh[:, 0] * SH_C0 + 0.5, 0, 1)
    return Sample(
        seconds,
        frame.ids,
        GaussianSet(
            positions=splats.means,
            scales=np.exp(splats.log_scales),
            rotations=np.roll(unit_rotations(splats), -1, axis=1),
            colors=np.concatenate([colours, opacities(splats)[:, None]], axis=1),
            motions=np.zeros((count, 3), np.float32),
            mu_t=np.zeros(count, np.float32),
            sigma_t=np.full(count, _NEVER_FADES, np.float32),
            win_lo=np.zeros(count),
            win_hi=np.full(count, _NEVER_FADES),
        ),
    )


_ONE_GRID = (
    f"{NO_DIRECTIONS} Its package's writer of keyframe-delta files writes no more, though the format could hold it. "
    "Colours outside 0..1 are put at its ends; positions lie within a share of the median size of all Gaussians. Each "
    "frame is one of its samples, in which no Gaussian moves or fades by itself; a file plays from its front on, so "
    "that its first frame is what lies before the second one."
)


def _fourdgs(coder: FourDGS, note: str) -> Rival:
    keyframes = "first" if coder.keyframe_every is None else f"every{coder.keyframe_every}"
    description = f"4dgs, profile {coder.profile}, {note}"
    return Rival(f"4dgs-{coder.profile}-{keyframes}", "4dgs", description, coder, _ONE_GRID)


RIVALS = (
    _fourdgs(FourDGS("default", 8, None), "a keyframe every 8 frames, deflate (as it comes)"),
    _fourdgs(FourDGS("fine"), "one keyframe, zstd 19"),
    _fourdgs(FourDGS("default"), "one keyframe, zstd 19"),
    _fourdgs(FourDGS("coarse"), "one keyframe, zstd 19"),
)
