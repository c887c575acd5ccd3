"""The .splat of web viewers: 32 bytes for each Gaussian, and no view-dependent colour."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from ..splats import SH_C0, Splats
from . import ANY_SIZE, Extremes
from .quantised import logits, opacities, to_bytes, unit_rotations

RECORD = np.dtype(
    [("mean", "<f4", 3), ("scale", "<f4", 3), ("colour", "u1", 3), ("opacity", "u1"), ("rotation", "u1", 4)]
)


@dataclass(frozen=True)
class Splat:
    """One frame: float32 places and sizes, 8 bits for colour, opacity and quaternion. Source: antimatter15/splat.

    It is a table without a header, which has no place to state ``compensated``.
    """

    compensated: bool = False
    suffix: ClassVar[str] = ".splat"
    up: ClassVar[Literal["Y", "-Y"]] = "-Y"
    log_scales: ClassVar[tuple[float, float]] = ANY_SIZE

    def fitted(self, extremes: Extremes) -> tuple[Splat, list[str]]:
        left_out = []
        if self.compensated:
            left_out.append("the compensation of opacity cannot be stated, so that small Gaussians show too strong")
        if extremes.sh_degree:
            left_out.append(f"view dependence (SH degree {extremes.sh_degree}) has no place and is left out")
        return self, left_out

    def encode(self, splats: Splats) -> bytes:
        return records(splats).tobytes()

    def decode(self, data: bytes) -> Splats:
        table = np.frombuffer(data, RECORD)
        # Four bytes of 128, all zero, are no rotation.
        quaternions = table["rotation"] / np.float32(128) - 1
        quaternions[~quaternions.any(axis=1)] = (1, 0, 0, 0)
        arrays = (
            table["mean"],
            np.log(np.maximum(table["scale"], np.finfo(np.float32).tiny)),
            quaternions,
            logits(table["opacity"] / np.float32(255)),
            (table["colour"][:, None] / np.float32(255) - 0.5) / SH_C0,
        )
        return Splats(*(np.ascontiguousarray(array, np.float32) for array in arrays))


def records(splats: Splats) -> NDArray[np.void]:
    """The Gaussians as records (N,) of RECORD."""
    table = np.zeros(len(splats), RECORD)
    table["mean"] = splats.means
    table["scale"] = np.exp(splats.log_scales)
    table["colour"] = to_bytes((0.5 + SH_C0 * splats.sh[:, 0]) * 255)
    table["opacity"] = to_bytes(opacities(splats) * 255)
    table["rotation"] = to_bytes(unit_rotations(splats) * 128 + 128)
    return table


Format = Splat
