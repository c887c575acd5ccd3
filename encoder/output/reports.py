"""The reports of an encode: of every frame, and of the whole stream."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

from decogs.formats.frames.ranges import frames_text

OnFrame = Callable[["FrameReport"], None]
OnKeyframeStep = Callable[[int, int, float], None]
"""Called with the step (from 1), the number of steps planned and the training loss."""
_MAX_REASONS = 4
"""Reasons why one camera was left out that are listed each; of more, the first one stands for all."""


@dataclass(frozen=True)
class FrameReport:
    """One encoded frame: the rig's index, its coding, cost and quality.

    ``bytes``: size of the packet on disk. ``selected``: share of the Gaussians in S_t.
    ``training_psnr``, ``held_out_psnr``: dB, means over the views, of the reconstructed state; the first against the
    compensated pictures, the second None without held-out cameras. Both are of pictures ``scale`` times as large as the
    cameras' own. ``held_out_own_size_psnr``: of the held-out cameras' decoded views at their own size against what they
    recorded, lens included; None without them, and where ``scale`` is 1.
    ``seconds``: wall clock by stage. ``cpu_seconds``: processor time of all threads, from decoded pictures to the
    written packet, without measuring (the stage "measure").
    ``replayed``: the frame was written by an earlier encode. ``effects``: those that it was trained for; none for a
    first frame, a replayed one and a deferred one, which a time budget leaves untrained.
    ``left_out``: cameras without a usable picture of the frame, and why (`rig.pictures.dropouts`).
    ``dropped``: cameras that had no picture of the frame, or none that can be cut out, and why.
    ``recorded``: digests of the pictures, by camera.
    ``rejected``: training made the pictures worse, so the scene was kept.
    ``uncorrected``: compensation that ends with this frame because it gained nothing, such as "cam04: colours".
    ``full_frame_change``: the masks found no change although most of the pictures had changed; every Gaussian was
    trained. ``cut``: the frame shows another scene than the one before, and got a new keyframe.
    """

    frame: int
    kind: str
    bytes: int
    gaussians: int
    selected: float
    training_psnr: float
    held_out_psnr: float | None
    seconds: dict[str, float]
    costs: dict[str, int]
    cpu_seconds: float
    replayed: bool = False
    effects: list[str] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)
    dropped: dict[str, str] = field(default_factory=dict)
    rejected: bool = False
    uncorrected: list[str] = field(default_factory=list)
    full_frame_change: bool = False
    cut: bool = False
    scale: float = 1.0
    held_out_own_size_psnr: float | None = None
    recorded: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class EncodeReport:
    """A finished encode: the stream's path (``-`` for a pipe) and its frames.

    ``interrupted``: Ctrl-C ended it early. ``resumed``: how many frames an earlier encode had left, None without
    ``resume``; ``frames`` is empty when that was the whole stream. ``frame_budget`` and
    ``time_budget``: the settings'. ``part``: the rig's frames of a part, None for a whole stream.
    ``held_out_sizes``: of every held-out camera, width and height at which ``held_out_psnr`` was measured, and its own.
    """

    output: Path
    frames: list[FrameReport]
    total_bytes: int
    interrupted: bool
    resumed: int | None = None
    frame_budget: float | None = None
    time_budget: float | None = None
    part: range | None = None
    held_out_sizes: dict[str, tuple[tuple[int, int], tuple[int, int]]] = field(default_factory=dict)


def left_out_warnings(frames: Sequence[FrameReport], warned_frames: Mapping[str, Collection[int]]) -> Iterator[str]:
    """A line for every camera and reason, with the frames that the camera had no part in.

    ``warned_frames``: by camera, frames of which the user knows; none where these are all.
    """
    by_camera: dict[str, dict[str, list[int]]] = {}
    for frame in frames:
        why = {name: f"its picture is {why}" for name, why in frame.left_out.items()} | frame.dropped
        for name, reason in why.items():
            by_camera.setdefault(name, {}).setdefault(reason, []).append(frame.frame)
    for name, reasons in by_camera.items():
        if len(reasons) > _MAX_REASONS:
            first = f"{next(iter(reasons))} (and {len(reasons) - 1} more such)"
            reasons = {first: sorted(chain.from_iterable(reasons.values()))}
        for reason, numbers in reasons.items():
            if not set(numbers) <= set(warned_frames.get(name, ())):
                yield f"camera {name} was left out of {frames_text(numbers)}: {reason}"
