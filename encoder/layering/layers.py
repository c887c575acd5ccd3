"""A take in two layers: a base that stands alone, and all of it (SPEC.md, "Layers")."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from decogs.codec.header.layer_list import Layer
from decogs.codec.scene.state import Rows, State, changed_between, same_scene
from decogs.decoder.editing.take import Frame, Take
from decogs.formats.errors import UsageError

from .rounds import Footage, Round, RoundMaker

_ROUND_FRAMES = 60
"""In which the base drifts by a dB or two from what it was trained for, on moving scenes."""
_MOMENTS = 6
"""Frames of a round that are trained on."""


def layered(take: Take, share: float) -> Take:
    """The take with a base of about this ``share`` of its Gaussians. Raises UsageError for frames without any.

    All frames are read once for that; training takes some seconds for each round.
    """
    maker, rounds = RoundMaker(take.header, share, take.threads), list[Round]()
    borders, moved = _rounds(take), np.zeros(0, np.int64)
    for frames in borders:
        footage = _footage(take, frames)
        rounds.append(maker.made(footage, rounds[-1] if rounds else None, np.union1d(footage.moved, moved)))
        moved = footage.moved

    def read(start: int, stop: int) -> Iterator[Frame]:
        coming = zip(borders, rounds, strict=True)
        frames, now = next(coming)
        for number, frame in enumerate(take.read(start, stop), start=start):
            while number not in frames:
                frames, now = next(coming)
            yield replace(frame, base=now.base(frame.state), coded=None)

    likest = [dB for each in rounds for dB in each.likeness]
    psnr = float(np.mean(likest))
    header = replace(take.header, layers=(Layer(0, 0.0, psnr), Layer(0, 0.0)))
    note = f"layer: a base of {share:.0%} of the Gaussians, {psnr:.1f} dB of the whole (worst frame {min(likest):.1f})"
    return replace(take, header=header, read=read).with_note(note)


def _rounds(take: Take) -> list[range]:
    """The frames of each round: about as many in each, but that one begins with a segment if one begins thereabouts."""
    parts = max(1, round(take.frame_count / _ROUND_FRAMES))
    even = [take.frame_count * part // parts for part in range(1, parts)]
    nearest = [min(take.starts, key=lambda start: abs(start - border)) for border in even]
    borders = [
        start if abs(start - border) <= _ROUND_FRAMES // 4 else border
        for start, border in zip(nearest, even, strict=True)
    ]
    return [range(a, b) for a, b in pairwise([0, *borders, take.frame_count])]


def _footage(take: Take, frames: range) -> Footage:
    """Some of the frames' scenes, the first among them, and the ids of what changes from frame to frame."""
    wanted = {round(at) for at in np.linspace(frames.start, frames.stop - 1, min(_MOMENTS, len(frames)))}
    scenes, changed, before = list[State](), list[Rows](), None
    for number, frame in enumerate(take.read(frames.start, frames.stop), frames.start):
        if before is not None and not same_scene(before, frame.state):
            changed.append(before.ids[changed_between(before, frame.state)])
        before = frame.state
        if number in wanted:
            scenes.append(frame.state)
    if not any(map(len, scenes)):
        where = f"frames {frames.start} to {frames.stop - 1}"
        raise UsageError(f"layer: no Gaussian is there in {where}; `trim` them away")
    return Footage(scenes, changed)
