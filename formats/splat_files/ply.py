"""The .ply that 3DGS's authors write: float32, normals that are zero, higher SH coefficients channel by channel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from ..splats import Splats
from . import Extremes

_HEADER_END = b"end_header\n"
_COMPENSATED = "comment SplatRenderMode: mip"
"""As gsplat (its pull request 1036) and Brush state it."""


@dataclass(frozen=True)
class Ply:
    """One frame; lossless. Source: INRIA gaussian-splatting, ``GaussianModel.save_ply``.

    Up is -Y: the files hold worlds as COLMAP leaves them, and viewers (SuperSplat, splat-transform) turn them over.
    """

    compensated: bool = False
    suffix: ClassVar[str] = ".ply"
    up: ClassVar[Literal["Y", "-Y"]] = "-Y"

    def fitted(self, extremes: Extremes) -> tuple[Ply, list[str]]:
        return self, []

    def encode(self, splats: Splats) -> bytes:
        count, rest = len(splats), splats.sh.shape[1] - 1
        columns = [
            splats.means,
            np.zeros((count, 3), np.float32),
            splats.sh[:, 0],
            splats.sh[:, 1:].transpose(0, 2, 1).reshape(count, 3 * rest),
            splats.opacity_logits[:, None],
            splats.log_scales,
            splats.quaternions,
        ]
        return self._header(count, rest) + np.concatenate(columns, axis=1).astype("<f4").tobytes()

    def decode(self, data: bytes) -> Splats:
        start = data.index(_HEADER_END) + len(_HEADER_END)
        lines = data[:start].decode("ascii").splitlines()
        count = next(int(line.split()[-1]) for line in lines if line.startswith("element vertex "))
        rest = sum("f_rest_" in line for line in lines) // 3
        table = np.frombuffer(data, "<f4", offset=start).reshape(count, 17 + 3 * rest)
        means, _, sh_dc, sh_rest, opacity_logits, log_scales, quaternions = np.split(
            table, np.cumsum([3, 3, 3, 3 * rest, 1, 3]), axis=1
        )
        sh = np.concatenate([sh_dc[:, None], sh_rest.reshape(count, 3, rest).transpose(0, 2, 1)], axis=1)
        arrays = (means, log_scales, quaternions, opacity_logits[:, 0], sh)
        return Splats(*(np.ascontiguousarray(array, np.float32) for array in arrays))

    def _header(self, count: int, rest: int) -> bytes:
        names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
        names += [f"f_rest_{i}" for i in range(3 * rest)]
        names += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
        comments = [_COMPENSATED] if self.compensated else []
        lines = ["ply", "format binary_little_endian 1.0", *comments, f"element vertex {count}"]
        return "\n".join([*lines, *(f"property float {name}" for name in names)]).encode() + b"\n" + _HEADER_END


Format = Ply
