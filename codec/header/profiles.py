"""Profiles: what players of a kind hold and fetch, and which of them a stream asks no more of (SPEC.md, "Profiles")."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

BUFFER_SECONDS = 2
"""Of a profile's rate: how much a player has fetched before it begins."""
NO_PROFILE = ""
_MAX_NAME = 32


@dataclass(frozen=True)
class Profile:
    """What a player of this kind can show: ``gaussians`` in any frame, SH to ``sh_degree``, so many bytes a second."""

    name: str
    gaussians: int
    sh_degree: int
    bytes_per_second: int


_RISING = (
    Profile("phone", 100_000, 1, 1_250_000),
    Profile("headset", 200_000, 1, 3_125_000),
    Profile("desktop", 1_000_000, 3, 12_500_000),
)
PROFILES = {profile.name: profile for profile in _RISING}
"""By name, each with more room than those before it."""


@dataclass(frozen=True)
class Load:
    """What a stream, up to one of its layers, asks of a player.

    ``gaussians``: the most in any frame; ``buffers``: by profile, the largest share of its buffer that is ever used at
    its rate, more than 1 where playing would stop; infinite without a frame rate.
    """

    gaussians: int
    sh_degree: int
    buffers: dict[str, float]

    def excess(self, profile: Profile) -> str:
        """In what it asks for more than the profile allows; empty if in nothing."""
        if self.gaussians > profile.gaussians:
            return f"it has up to {self.gaussians} Gaussians, of {profile.gaussians}"
        if self.sh_degree > profile.sh_degree:
            return f"it has SH degree {self.sh_degree}, of {profile.sh_degree}"
        if math.isinf(share := self.buffers[profile.name]):
            return "it states no frame rate"
        rate = f"at {8 * profile.bytes_per_second / 1e6:g} Mbit/s"
        return f"{rate} it needs {share:.2f} times the buffer of {BUFFER_SECONDS} s" if share > 1 else ""

    @property
    def profile(self) -> str:
        """The name of the first profile that it keeps within; empty for none."""
        return next((profile.name for profile in _RISING if not self.excess(profile)), NO_PROFILE)


def load(frames: Sequence[tuple[int, int]], sh_degree: int, fps: float | None) -> Load:
    """The load of ``frames``, each with its Gaussians and its bytes on disk, sound among them."""
    sizes = [size for _, size in frames]
    buffers = {
        name: math.inf if fps is None else _fullest(sizes, profile.bytes_per_second, fps)
        for name, profile in PROFILES.items()
    }
    return Load(max((gaussians for gaussians, _ in frames), default=0), sh_degree, buffers)


def _fullest(sizes: Sequence[int], bytes_per_second: int, fps: float) -> float:
    level = fullest = 0.0
    for size in sizes:
        # What came in a frame's time leaves; what a player had no room for would have been fetched later.
        level = max(0.0, level - bytes_per_second / fps) + size
        fullest = max(fullest, level)
    return fullest / (BUFFER_SECONDS * bytes_per_second)


def read_profiles(document: object, layers: int) -> tuple[str, ...]:
    """The names in a header's member ``profiles``, one for each of so many layers; none where it is out of bounds.

    Names that this version does not know are kept.
    """
    if not isinstance(document, list) or len(document) != layers:
        return ()
    names = [name for name in document if isinstance(name, str) and len(name) <= _MAX_NAME and name.isprintable()]
    return tuple(names) if len(names) == layers else ()
