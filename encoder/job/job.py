"""What an encode is asked for, as one plain object."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import BinaryIO

from decogs.formats.frames.ranges import Frames
from decogs.formats.rigs import Rig
from decogs.rig.mattes import MatteChoice

from ..analysis import EffectChoice
from ..settings.effects import CorrectionSettings
from ..settings.encode import EncodeSettings
from .switches import Switches
from .targets import Targets

PathLike = str | os.PathLike[str]


@dataclass(frozen=True)
class EncodeJob:
    """A rig of synchronised, calibrated cameras, and how it becomes a .dgs stream.

    No file of the rig, nor the one of ``keyframe``, is ever written over; an output that another encode writes, or has
    left unfinished, is refused.
    """

    rig: PathLike | Rig  # its folder or calibration file, or the rig itself
    output: PathLike | BinaryIO  # the file to write, or an open one that takes bytes, such as a pipe
    settings: str | EncodeSettings = "standard"  # a name in PRESETS, or settings

    frames: Frames = None  # consecutive ones, as a slice or a range; None: all
    scale: float = 1.0  # of the pictures trained on, above 0 and at most 4
    holdout: Sequence[str] = ()  # names of cameras kept out of training and measured on
    exclude: Sequence[str] = ()  # names of cameras that are left out altogether

    mattes: MatteChoice | None = None  # what of the pictures is the subject; None: as their own alpha says

    audio: PathLike | None = None  # sound for the stream: a camera's name, "auto", or a file, from the rig's frame 0 on

    switches: Switches | None = None  # method of later frames and its parts, on top of the settings
    targets: Targets | None = None  # quality, bytes and time, on top of the settings
    effects: EffectChoice | str | None = None  # as `effect_choice` reads it; None: "auto" for a preset, else as it says
    corrections: CorrectionSettings | None = None  # cameras whose drift is known; None: as ``effects`` detects
    keyframe: PathLike | None = None  # an earlier stream's first frame, or another trainer's .ply or .spz, as it is
    segment: int | None = None  # frames from one keyframe to the next, coded as a difference from the first
    closed: bool = False  # every segment starts from the first keyframe and depends on no other
    only: Frames = None  # whole closed segments, or the first frame: the output is a part, for `join`
    resume: bool = False  # go on with what the same encode left; the file gets the bytes of one that was not cut off
    layers: bool = False  # written as a base and what refines it, while it is encoded; not parts, nor with ``resume``
    metrics: bool = False  # every frame's PSNR goes into the stream, for the player

    seed: int = 0  # the same one gives the same bytes, except with a time budget
    threads: int = 0  # 0: all processors; the stream does not depend on it
    device: str = "auto"  # "cuda" takes torch and gives other bits than "cpu"; "auto" is "cpu"
    max_memory: int | None = None  # bytes beyond the program itself; None: no limit

    log: PathLike | None = None  # file for JSON lines, continued with ``resume``
    convergence_log: PathLike | None = None  # file for the loss of every training step, likewise
