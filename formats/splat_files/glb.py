"""Binary glTF with KHR_gaussian_splatting: float32 attributes of points, which other programs show as a point cloud.

Source: KhronosGroup/glTF, extensions/2.0/Khronos/KHR_gaussian_splatting, a release candidate in August 2026, and glTF
2.0, section 4 ("GLB File Format Specification"). Scales are linear there; drafts until 2025 had logarithms.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from ..colours.srgb import linear_from_srgb
from ..errors import UsageError
from ..splats import SH_C0, Splats, sh_degree_of
from . import ANY_SIZE, Extremes, needs_gaussians
from .quantised import logits, opacities, unit_rotations

_GLB, _CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")
_FLOAT, _SHORT, _POINTS, _VERTICES = 5126, 5123, 0, 34962
_KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
_EXTENSION = "KHR_gaussian_splatting"
_OF_HEADERS = 1 << 16
"""More bytes than the JSON of the most attributes takes."""


@dataclass(frozen=True)
class Glb:
    """One frame; exact but for the activation of scale and opacity. ``compensated`` stands in the primitive's extras:
    the extension has no property for it."""

    compensated: bool = False
    suffix: ClassVar[str] = ".glb"
    up: ClassVar[Literal["Y", "-Y"]] = "Y"
    log_scales: ClassVar[tuple[float, float]] = ANY_SIZE

    def fitted(self, extremes: Extremes) -> tuple[Glb, list[str]]:
        needs_gaussians(extremes, self.suffix)
        size = extremes.largest * 4 * (13 + 3 * (extremes.sh_degree + 1) ** 2)
        if size + _OF_HEADERS >= 1 << 32:
            raise UsageError(f"a frame takes {size / 1e9:.1f} GB, and a .glb at most 4.29; write .ply")
        return self, []

    def encode(self, splats: Splats) -> bytes:
        attributes = _attributes(splats)
        offsets = np.cumsum([0, *(array.nbytes for array in attributes.values())])
        binary = b"".join(array.tobytes() for array in attributes.values())
        accessors = [_accessor(i, name, array) for i, (name, array) in enumerate(attributes.items())]
        primitive: dict[str, Any] = {
            "attributes": {name: i for i, name in enumerate(attributes)},
            "mode": _POINTS,
            "extensions": {
                _EXTENSION: {
                    "kernel": "ellipse",
                    "colorSpace": "srgb_rec709_display",
                    "projection": "perspective",
                    "sortingMethod": "cameraDistance",
                }
            },
        }
        if self.compensated:
            primitive["extras"] = {"SplatRenderMode": "mip"}
        document = {
            "asset": {"version": "2.0", "generator": "decogs"},
            "extensionsUsed": [_EXTENSION],
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [primitive]}],
            "buffers": [{"byteLength": len(binary)}],
            "bufferViews": [
                {"buffer": 0, "byteOffset": int(offset), "byteLength": array.nbytes, "target": _VERTICES}
                for offset, array in zip(offsets, attributes.values(), strict=False)
            ],
            "accessors": accessors,
        }
        text = json.dumps(document, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        size = _GLB.size + 2 * _CHUNK.size + len(text) + len(binary)
        head = _GLB.pack(b"glTF", 2, size) + _CHUNK.pack(len(text), b"JSON") + text
        return head + _CHUNK.pack(len(binary), b"BIN\0") + binary

    def decode(self, data: bytes) -> Splats:
        length, _ = _CHUNK.unpack_from(data, _GLB.size)
        text = _GLB.size + _CHUNK.size
        document = json.loads(data[text : text + length])
        start = text + length + _CHUNK.size
        arrays = {}
        for name, i in document["meshes"][0]["primitives"][0]["attributes"].items():
            view, accessor = document["bufferViews"][i], document["accessors"][i]
            if accessor["componentType"] == _FLOAT:
                floats = np.frombuffer(data, "<f4", view["byteLength"] // 4, start + view["byteOffset"])
                arrays[name.removeprefix(f"{_EXTENSION}:")] = floats.reshape(accessor["count"], -1)
        coefficients = sum(name.startswith("SH_DEGREE_") for name in arrays)
        names = _sh_names(sh_degree_of(coefficients))
        values = (
            arrays["POSITION"],
            np.log(np.maximum(arrays["SCALE"], np.finfo(np.float32).tiny)),
            np.roll(arrays["ROTATION"], 1, axis=1),
            logits(arrays["OPACITY"][:, 0]),
            np.stack([arrays[name] for name in names], axis=1),
        )
        return Splats(*(np.ascontiguousarray(array, np.float32) for array in values))


def _attributes(splats: Splats) -> dict[str, NDArray[Any]]:
    """Every attribute by its name, arrays (N, 1), (N, 3) or (N, 4) whose rows are multiples of 4 bytes.

    COLOR_0 is linear, as glTF wants it (3.9.2); 16 bits, because 8 show steps in the dark.
    """
    alpha = opacities(splats)[:, None]
    linear = linear_from_srgb(np.clip(0.5 + SH_C0 * splats.sh[:, 0], 0, 1))
    attributes: dict[str, NDArray[Any]] = {
        "POSITION": splats.means,
        "COLOR_0": np.rint(np.concatenate([linear, alpha], axis=1) * np.float32(65535)).astype(np.uint16),
        f"{_EXTENSION}:ROTATION": np.roll(unit_rotations(splats), -1, axis=1),
        f"{_EXTENSION}:SCALE": np.exp(splats.log_scales),
        f"{_EXTENSION}:OPACITY": alpha,
    }
    for k, name in enumerate(_sh_names(splats.sh_degree)):
        attributes[f"{_EXTENSION}:{name}"] = splats.sh[:, k]
    return {name: np.ascontiguousarray(array, array.dtype.newbyteorder("<")) for name, array in attributes.items()}


def _sh_names(degree: int) -> list[str]:
    return [f"SH_DEGREE_{band}_COEF_{n}" for band in range(degree + 1) for n in range(2 * band + 1)]


def _accessor(view: int, name: str, array: NDArray[Any]) -> dict[str, Any]:
    kind = _SHORT if array.dtype == np.uint16 else _FLOAT
    accessor = {"bufferView": view, "componentType": kind, "count": len(array), "type": _KINDS[array.shape[1]]}
    if kind == _SHORT:
        accessor["normalized"] = True
    if name == "POSITION":
        accessor |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
    return accessor


Format = Glb
