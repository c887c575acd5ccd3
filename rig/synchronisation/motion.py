"""When each camera starts, by what moves in its pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from decogs.formats.cameras import Camera

from ..parallel import Each
from .agreement import agreement
from .joint import StartEstimate, joint_starts
from .motion_signals import U8, planes_of, signals_of


def starts_by_motion(
    cameras: Sequence[Camera],
    pictures: Sequence[Iterable[U8]],
    each: Each,
    on_camera: Callable[[int], None] = lambda done: None,
) -> StartEstimate:
    """The starts of cameras, in frames, by grey ``pictures`` (H, W) of each, of successive frames from its first on."""
    planes = planes_of(cameras)
    signals = []
    for own in each(lambda row, clip: signals_of(row, planes, clip), range(len(cameras)), pictures):
        signals.append(own)
        on_camera(len(signals))
    lengths = [next(iter(own.values())).shape[1] if own else 0 for own in signals]
    reach = max(lengths, default=0)
    pairs = each(
        lambda pair: agreement(pair[0], pair[1], signals[pair[0]][pair[1]], signals[pair[1]][pair[0]], reach), planes
    )
    return joint_starts(len(cameras), list(pairs))
