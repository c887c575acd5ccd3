"""Files of one frame each, in the formats that viewers take: PLY, SPZ, SOG and .splat."""

from __future__ import annotations

from decogs.formats.splat_files.ply import Ply
from decogs.formats.splat_files.sog import Sog
from decogs.formats.splat_files.splat import Splat
from decogs.formats.splat_files.spz import Spz, SpzVersion

from .sequences import NO_DIRECTIONS, FilePerFrame, Rival


def _spz(
    version: SpzVersion, fraction_bits: int = 12, sh1_bits: int = 5, sh_rest_bits: int = 4, note: str = ""
) -> Rival:
    return Rival(
        f"spz{version}-{fraction_bits}-{sh1_bits}-{sh_rest_bits}",
        f"SPZ {version}",
        f"SPZ {version} per frame, positions 2^-{fraction_bits}, SH {sh1_bits}/{sh_rest_bits} bit{note}",
        FilePerFrame(Spz(fraction_bits, sh1_bits, sh_rest_bits, version)),
    )


RIVALS = (
    Rival("ply", "PLY", "INRIA .ply per frame", FilePerFrame(Ply())),
    _spz(3, note=" (its library's default)"),
    _spz(4, 14, 8, 8),
    _spz(4, note=" (its library's default)"),
    _spz(4, 10, 4, 3),
    _spz(4, 8, 3, 3),
    Rival("sog", "SOG", "SOG v2 per frame", FilePerFrame(Sog())),
    Rival("splat", ".splat", ".splat per frame (what splats4d takes)", FilePerFrame(Splat()), NO_DIRECTIONS),
)
