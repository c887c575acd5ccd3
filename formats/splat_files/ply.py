"""The .ply that 3DGS's authors write: float32, normals that are zero, higher SH coefficients channel by channel.

Read are their relatives, too: Inria's, gsplat's, nerfstudio's, Postshot's and SuperSplat's differ in the order of the
properties, in properties that mean nothing here, in their types, and in the SH degree, from 0 to 3. Mip-Splatting's
``filter_3D`` means something: it is baked in.
Source of the header's grammar: Turk, "The PLY Polygon File Format".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError
from ..splats import SH_C0, FloatArray, Splats
from . import ANY_SIZE, Extremes, Room

_HEADER_END = b"end_header\n"
_COMPENSATED = "comment SplatRenderMode: mip"
"""As gsplat (its pull request 1036) and Brush state it."""

_LARGEST_HEADER = 1 << 16
_LARGEST_ROW = 1 << 16
_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
_MEANS, _SCALES, _ROTATIONS = ("x", "y", "z"), ("scale_0", "scale_1", "scale_2"), ("rot_0", "rot_1", "rot_2", "rot_3")
_FILTER = "filter_3D"
_SH_DC, _RGB = ("f_dc_0", "f_dc_1", "f_dc_2"), ("red", "green", "blue")
_REST = (0, 3, 8, 15)
"""Higher SH coefficients per channel, by degree."""


@dataclass(frozen=True)
class Ply:
    """One frame; lossless. Source: INRIA gaussian-splatting, ``GaussianModel.save_ply``.

    Up is -Y: the files hold worlds as COLMAP leaves them, and viewers (SuperSplat, splat-transform) turn them over.
    """

    compensated: bool = False
    suffix: ClassVar[str] = ".ply"
    up: ClassVar[Literal["Y", "-Y"]] = "-Y"
    log_scales: ClassVar[tuple[float, float]] = ANY_SIZE

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
        return parse_ply(data, Room())[0]

    def _header(self, count: int, rest: int) -> bytes:
        names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
        names += [f"f_rest_{i}" for i in range(3 * rest)]
        names += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
        comments = [_COMPENSATED] if self.compensated else []
        lines = ["ply", "format binary_little_endian 1.0", *comments, f"element vertex {count}"]
        return "\n".join([*lines, *(f"property float {name}" for name in names)]).encode() + b"\n" + _HEADER_END


def parse_ply(data: bytes, room: Room) -> tuple[Splats, bool]:
    """A file's Gaussians, as far as there is room, and whether it says that they are drawn with compensation.

    Colours may be f_dc or, as nerfstudio can write them, red, green and blue of 8 bits. Files with ``filter_3D`` were
    trained with Mip-Splatting, whose renderer compensates. Raises UsageError, without the file's name.
    """
    lines, start = _header_lines(data)
    order = _byte_order(lines)
    vertices = None
    for element in _elements(lines, order):
        if element.name == "vertex":
            vertices = element
            break
        start += element.bytes
    if vertices is None:
        raise UsageError('has no element "vertex"; export it as a .ply of 3D Gaussians')
    _check_properties(vertices.names)
    room.check(vertices.count, 1 + _higher_coefficients(vertices.names), len(data))
    if vertices.bytes > len(data) - start:
        raise UsageError(
            f"is cut off: {vertices.count} Gaussians take {vertices.bytes} bytes, and {max(0, len(data) - start)} "
            "are there; export it again"
        )
    table = np.frombuffer(memoryview(data)[start : start + vertices.bytes], vertices.row)
    return _splats(table), _COMPENSATED in lines or _FILTER in vertices.names


@dataclass(frozen=True)
class _Element:
    """So many rows of the type ``row``."""

    name: str
    count: int
    row: np.dtype[np.void]

    @property
    def names(self) -> tuple[str, ...]:
        return self.row.names or ()

    @property
    def bytes(self) -> int:
        return self.count * self.row.itemsize


def _header_lines(data: bytes) -> tuple[list[str], int]:
    """The header's lines, and where the rows begin."""
    head = data[:_LARGEST_HEADER]
    if head[:4] not in (b"ply\n", b"ply\r"):
        raise UsageError("is no .ply; export it again")
    # Comments may say anything, "end_header" among it.
    end = head.find(b"\nend_header")
    stop = head.find(b"\n", end + 1)
    if end < 0 or stop < 0:
        raise UsageError(f"has no end of its header within {_LARGEST_HEADER} bytes; export it again")
    return [line.strip() for line in head[:end].decode("latin-1").split("\n")], stop + 1


def _byte_order(lines: list[str]) -> str:
    statement = next((line.split() for line in lines if line.startswith("format ")), [])
    if len(statement) > 1 and statement[1] == "ascii":
        raise UsageError("is a .ply in ASCII, which is not read; export it as binary")
    if len(statement) != 3 or statement[1] not in _ORDERS:
        raise UsageError("states no known format of a .ply; export it as binary, little endian")
    return _ORDERS[statement[1]]


def _elements(lines: list[str], order: str) -> list[_Element]:
    """The elements up to the Gaussians."""
    elements: list[_Element] = []
    at = [number for number, line in enumerate(lines) if line.startswith("element ")]
    for first, last in zip(at, [*at, len(lines)][1:], strict=True):
        words = lines[first].split()
        if len(words) != 3 or not words[2].isascii() or not words[2].isdigit() or len(words[2]) > 12:
            raise UsageError(f"has a line in its header that is no element: {lines[first][:60]!a}; export it again")
        properties = [line.split() for line in lines[first + 1 : last] if line.startswith("property ")]
        if any(name.startswith("packed_") for *_, name in properties):
            raise UsageError("is a compressed .ply, which is not read; export it as a plain one")
        elements.append(_Element(words[1], int(words[2]), _row(words[1], properties, order)))
        if words[1] == "vertex":
            break
    return elements


def _row(element: str, properties: list[list[str]], order: str) -> np.dtype[np.void]:
    fields: dict[str, str] = {}
    for words in properties:
        if len(words) != 3 or words[1] not in _TYPES:
            raise UsageError(
                f"has rows of {element!a} that no 3D Gaussians have: {' '.join(words)[:60]!a}; export plain"
            )
        if words[2] in fields:
            raise UsageError(f"has the property {words[2][:40]!a} twice; export it again")
        fields[words[2]] = order + _TYPES[words[1]]
    row = np.dtype(list(fields.items()))
    if row.itemsize > _LARGEST_ROW:
        raise UsageError(f"has rows of {row.itemsize} bytes; export it with fewer properties")
    return row


def _check_properties(names: tuple[str, ...]) -> None:
    colours = _SH_DC if any(name in names for name in _SH_DC) else _RGB if "red" in names else _SH_DC
    missing = [name for name in (*_MEANS, *_SCALES, *_ROTATIONS, *colours, "opacity") if name not in names]
    if missing:
        raise UsageError(f"has no property {missing[0]}, so it is no .ply of 3D Gaussians; export it as such")
    rest = sum(name.startswith("f_rest_") for name in names)
    if rest % 3 or rest // 3 not in _REST or any(f"f_rest_{i}" not in names for i in range(rest)):
        raise UsageError(f"has {rest} properties f_rest, which is no SH degree from 0 to 3; export it again")


def _higher_coefficients(names: tuple[str, ...]) -> int:
    return sum(name.startswith("f_rest_") for name in names) // 3


def _splats(table: NDArray[np.void]) -> Splats:
    def columns(names: tuple[str, ...]) -> FloatArray:
        # What float32 cannot hold becomes infinite, and is left out as such.
        with np.errstate(over="ignore", invalid="ignore"):
            return np.stack([table[name].astype(np.float32) for name in names], axis=1)

    names = table.dtype.names or ()
    rest = _higher_coefficients(names)
    sh = np.empty((len(table), 1 + rest, 3), np.float32)
    sh[:, 0] = columns(_SH_DC) if _SH_DC[0] in names else (columns(_RGB) / 255 - 0.5) / SH_C0
    if rest:
        higher = columns(tuple(f"f_rest_{i}" for i in range(3 * rest)))
        sh[:, 1:] = higher.reshape(len(table), 3, rest).transpose(0, 2, 1)
    log_scales, opacity_logits = columns(_SCALES), columns(("opacity",))[:, 0].copy()
    if _FILTER in names:
        log_scales, opacity_logits = _filtered(log_scales, opacity_logits, columns((_FILTER,)))
    return Splats(columns(_MEANS), log_scales, columns(_ROTATIONS), opacity_logits, sh)


def _filtered(log_scales: FloatArray, opacity_logits: FloatArray, filters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Log scales and opacity logits with Mip-Splatting's 3D filter, of sizes ``filters`` (N, 1), baked in.

    Sizes become sqrt(s^2 + f^2), opacities shrink as the volume grows. Source: mip-splatting, ``create_fused_ply``.
    """
    with np.errstate(all="ignore"):  # what is not finite stays so, and is seen to by whoever reads
        before = log_scales.astype(np.float64)
        after = np.logaddexp(2 * before, 2 * np.log(np.abs(filters.astype(np.float64)))) / 2
        shrunk = np.where(after == before, 0, before - after).sum(axis=1)
        log_opacities = shrunk - np.logaddexp(0, -opacity_logits.astype(np.float64))
        logits = log_opacities - np.log(-np.expm1(log_opacities))
        return after.astype(np.float32), logits.astype(np.float32)


Format = Ply
