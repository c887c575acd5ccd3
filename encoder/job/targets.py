"""A stream's targets: quality, bytes and time."""

from __future__ import annotations

from dataclasses import dataclass, replace

from decogs.codec.header.profiles import Profile
from decogs.formats.errors import UsageError

from ..coding.rate_control import with_budget, with_lossless, with_quality
from ..coding.time_control import with_target_psnr, with_time_budget
from ..settings.checked import Checked
from ..settings.encode import EncodeSettings
from ..training.method import MAX_GROWTH


@dataclass(frozen=True)
class Targets(Checked):
    """A stream's targets on top of its settings; None: as the settings have it.

    ``quality``: 0 (smallest) to 100 (most exact), 50 is the settings as they are; with a keyframe of an earlier stream,
    that of later frames. ``bytes_per_frame``: most that the frames after the first may take on average, keyframes among
    them included. ``lossless``: every change is written exactly as trained, to the lattice's steps. ``time_budget``:
    seconds that a frame after the first may take on average, wall clock; training is shortened to fit, and the bytes
    then depend on the machine. ``target_psnr``: dB in the training views' regions of interest (in a keyframe:
    everywhere) at which a frame's training ends. ``profile``: that whose Gaussians and SH degree bound the scene.
    """

    quality: float | None = None
    bytes_per_frame: float | None = None
    lossless: bool = False
    time_budget: float | None = None
    target_psnr: float | None = None
    profile: Profile | None = None


def with_targets(settings: EncodeSettings, targets: Targets) -> EncodeSettings:
    """The settings with these targets; raises UsageError for those out of range or that exclude each other."""
    given = {"quality": targets.quality, "bytes_per_frame": targets.bytes_per_frame}
    lossy = [name for name, value in given.items() if value is not None]
    if targets.lossless and lossy:
        raise UsageError(f"`lossless`: `{lossy[0]}` codes less than every change; drop one of the two")
    if targets.lossless:
        settings = with_lossless(settings)
    if targets.quality is not None:
        settings = with_quality(settings, targets.quality)
    if targets.bytes_per_frame is not None:
        settings = with_budget(settings, targets.bytes_per_frame)
    if targets.time_budget is not None:
        settings = with_time_budget(settings, targets.time_budget)
    if targets.profile is not None:
        settings = _within(settings, targets.profile)
    return settings if targets.target_psnr is None else with_target_psnr(settings, targets.target_psnr)


def _within(settings: EncodeSettings, profile: Profile) -> EncodeSettings:
    keyframe = settings.keyframe
    cap = min(keyframe.cap, int(profile.gaussians / MAX_GROWTH))
    degree = min(keyframe.sh_degree, profile.sh_degree)
    return replace(settings, keyframe=replace(keyframe, cap=cap, sh_degree=degree))
