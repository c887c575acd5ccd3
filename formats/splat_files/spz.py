""".spz: fixed point and 8-bit values, behind gzip (versions 2 and 3) or, each kind by itself, zstd (version 4).

Source: the README of nianticlabs/spz, "File Format", as npm's @adobe/spz 4 has it, its extensions/README.md and its
src/cc/load-spz.cc. The axes
of a file are right, up, back; this turns nothing, whoever calls it does. Its library, in splat-transform 2.7.1, reads
what is written here with the values that ``parse_spz`` gives.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np
import zstandard
from numpy.typing import NDArray

from ..errors import UsageError
from ..splats import FloatArray, Splats
from . import Extremes, Room, needs_gaussians
from .quantised import logits, opacities, to_bytes, unit_rotations

SpzVersion = Literal[2, 3, 4]

_LEGACY_HEADER, _HEADER, _STREAM = struct.Struct("<IIIBBBB"), struct.Struct("<IIIBBBBI12x"), struct.Struct("<QQ")
_ORBIT, _ORBIT_TYPE = struct.Struct("<IIfff"), 0xADBE0002
_MAGIC = 0x5053474E
_ANTIALIASED, _EXTENDED = 1, 2
_COLOUR = 0.15
_LARGEST = 0.5**0.5
_MAGNITUDE = 511
_GZIP = 16 + zlib.MAX_WBITS
_LARGEST_WINDOW = 1 << 27
_LARGEST_FRACTION = 24
_ZSTD_LEVEL = 12
_MAX_BITS = 14
"""Fraction bits; 16 gained .08 dB against the decoded picture, of 53, and took 2 to 7 % more bytes (``workbench``)."""
_MIN_STEPS = 4096
"""Steps of a position up to the farthest, below which they show: a fiftieth of a room in metres."""
_REMEDY = "choose another `scale_to_metres`, or write .ply"
_MAX_GAUSSIANS = 10_000_000
"""That libraries for versions 2 and 3 read."""


@dataclass(frozen=True)
class SafeOrbit:
    """How viewers may circle: ``elevations`` in radians above what they look at, least and most, and how near,
    ``least_distance`` in world units (the extension SPZ_ADOBE_safe_orbit_camera)."""

    elevations: tuple[float, float]
    least_distance: float

    def record(self) -> bytes:
        return _ORBIT.pack(_ORBIT_TYPE, _ORBIT.size - 8, *self.elevations, self.least_distance)


@dataclass(frozen=True)
class Spz:
    """One frame. Defaults are the library's, but for the version, which is the newest that most readers know.

    ``fraction_bits``: of a position, in world units; it has 24 bits in all, and what lies outside them is put at their
    ends. ``sh1_bits``, ``sh_rest_bits``: kept of the 8 of each SH coefficient of degree 1 and above; what lies beyond
    +-1 is put there. ``compensated`` sets the flag "antialiased". ``orbit``: None says nothing of viewers;
    version 4 alone has room for it.
    """

    fraction_bits: int = 12
    sh1_bits: int = 5
    sh_rest_bits: int = 4
    version: SpzVersion = 3
    compensated: bool = False
    orbit: SafeOrbit | None = None
    suffix: ClassVar[str] = ".spz"
    up: ClassVar[Literal["Y", "-Y"]] = "Y"
    log_scales: ClassVar[tuple[float, float]] = (-10.0, 255 / 16 - 10)

    def fitted(self, extremes: Extremes) -> tuple[Spz, list[str]]:
        """With as many fraction bits as leave room for the farthest position, and all bits of SH.

        It says which sizes it clamps, and where positions become coarse.
        """
        needs_gaussians(extremes, self.suffix)
        if self.version < 4 and extremes.largest > _MAX_GAUSSIANS:
            raise UsageError(
                f"a frame has {extremes.largest} Gaussians, and readers of .spz version {self.version} take "
                f"{_MAX_GAUSSIANS}; write version 4, or .ply"
            )
        bits = next((b for b in range(_MAX_BITS, -1, -1) if extremes.farthest * (1 << b) <= (1 << 23) - 1), None)
        if bits is None:
            raise UsageError(
                f"a Gaussian lies {extremes.farthest:.3g} units from the origin, and .spz has room for {1 << 23}; "
                "write .ply"
            )
        lost, (least, most) = [], np.exp(self.log_scales)
        if extremes.clamped:
            lost.append(
                f"sizes of {extremes.clamped} Gaussians of a frame with {extremes.largest} lie outside of .spz's, "
                f"{least:.2g} to {most:.3g} units, and are clamped; {_REMEDY}"
            )
        if 0 < extremes.farthest * (1 << bits) < _MIN_STEPS:
            lost.append(
                f".spz has positions in steps of {0.5**bits:.2g} units, coarse for a scene that reaches "
                f"{extremes.farthest:.2g} units; {_REMEDY}"
            )
        return replace(self, fraction_bits=bits, sh1_bits=8, sh_rest_bits=8), lost

    def encode(self, splats: Splats) -> bytes:
        sh = splats.sh[:, 1:]
        bits = np.where(np.arange(sh.shape[1]) < 3, self.sh1_bits, self.sh_rest_bits)[:, None]
        rotations = unit_rotations(splats)
        columns = [
            _fixed_point(splats.means, self.fraction_bits).tobytes(),
            to_bytes(opacities(splats) * 255).tobytes(),
            to_bytes(splats.sh[:, 0] * (_COLOUR * 255) + 127.5).tobytes(),
            to_bytes((splats.log_scales + 10) * 16).tobytes(),
            (_first_three(rotations) if self.version == 2 else _smallest_three(rotations)).tobytes(),
            _bucketed(sh, 1 << (8 - bits)).tobytes(),
        ]
        fields = (_MAGIC, self.version, len(splats), splats.sh_degree, self.fraction_bits, self._flags)
        if self.version == 4:
            return _zstd_streams(fields, b"" if self.orbit is None else self.orbit.record(), columns)
        packer = zlib.compressobj(-1, zlib.DEFLATED, _GZIP, 9)
        return packer.compress(_LEGACY_HEADER.pack(*fields, 0) + b"".join(columns)) + packer.flush()

    @property
    def _flags(self) -> int:
        return _ANTIALIASED * self.compensated | _EXTENDED * (self.version == 4 and self.orbit is not None)

    def decode(self, data: bytes) -> Splats:
        return parse_spz(data, Room())[0]


def parse_spz(data: bytes, room: Room) -> tuple[Splats, bool]:
    """A file's Gaussians, as far as there is room, and whether its flag "antialiased" says that they are compensated.

    What follows the Gaussians (extensions, in version 4 more streams) is left alone. Raises UsageError, without the
    file's name.
    """
    head, raw = _unpacked(data, room)
    columns = np.split(np.frombuffer(raw, np.uint8), np.cumsum(head.widths * head.count)[:-1])
    means, alphas, colours, scales, rotations, sh = (
        column.reshape(head.count, width) for column, width in zip(columns, head.widths, strict=True)
    )
    coefficients = np.empty((head.count, head.coefficients, 3), np.float32)
    coefficients[:, 0] = (colours / 255 - 0.5) / _COLOUR
    coefficients[:, 1:] = sh.reshape(head.count, head.coefficients - 1, 3)
    coefficients[:, 1:] = (coefficients[:, 1:] - 128) / 128
    smallest = np.ascontiguousarray(rotations).view("<u4")[:, 0] if head.version > 2 else None
    arrays = (
        _from_fixed_point(means, head.fraction_bits),
        scales / 16 - 10.0,
        _from_first_three(rotations) if smallest is None else _from_smallest_three(smallest),
        logits(alphas[:, 0] / np.float32(255)),
        coefficients,
    )
    splats = Splats(*(np.ascontiguousarray(array, np.float32) for array in arrays))
    return splats, bool(head.flags & _ANTIALIASED)


def _zstd_streams(fields: tuple[int, ...], extensions: bytes, columns: list[bytes]) -> bytes:
    """Version 4: the header, extensions, each stream's two sizes, and the streams; one without bytes is not there."""
    raw = [column for column in columns if column]
    packed = [zstandard.ZstdCompressor(level=_ZSTD_LEVEL).compress(column) for column in raw]
    sizes = [_STREAM.pack(len(small), len(large)) for small, large in zip(packed, raw, strict=True)]
    header = _HEADER.pack(*fields, len(packed), _HEADER.size + len(extensions))
    return b"".join([header, extensions, *sizes, *packed])


@dataclass(frozen=True)
class _Head:
    """What a file's header says, within its bounds."""

    version: int
    count: int
    degree: int
    fraction_bits: int
    flags: int

    @property
    def coefficients(self) -> int:
        """Of SH, per channel."""
        return (self.degree + 1) ** 2

    @property
    def widths(self) -> NDArray[np.int64]:
        """Bytes of a Gaussian's position, opacity, colour, size, rotation and SH."""
        return np.array([9, 1, 3, 3, 3 if self.version == 2 else 4, 3 * (self.coefficients - 1)], np.int64)

    @property
    def sizes(self) -> list[int]:
        """The same of all Gaussians."""
        return [width * self.count for width in self.widths.tolist()]


def _unpacked(data: bytes, room: Room) -> tuple[_Head, bytes]:
    """The header, and the columns one after the other: no byte more is unpacked than the header says."""
    if data[:2] == b"\x1f\x8b":
        return _gunzipped(data, room)
    if len(data) < _HEADER.size or data[:4] != _MAGIC.to_bytes(4, "little"):
        raise UsageError("is no .spz; export it again")
    *fields, streams, at = _HEADER.unpack_from(data)
    head = _checked(fields, (4,))
    room.check(head.count, head.coefficients, len(data))
    start = at + streams * _STREAM.size
    wanted = [size for size in head.sizes if size]
    if streams < len(wanted) or at < _HEADER.size or start > len(data):
        raise UsageError("is damaged: its table of streams is cut off; export it again")
    columns = []
    for number, size in enumerate(wanted):
        packed, large = _STREAM.unpack_from(data, at + number * _STREAM.size)
        if large != size or packed > len(data) - start:
            raise UsageError(f"is damaged: stream {number} is not {size} bytes, or cut off; export it again")
        columns.append(_unzstd(data[start : start + packed], size))
        start += packed
    return head, b"".join(columns)


def _gunzipped(data: bytes, room: Room) -> tuple[_Head, bytes]:
    unpacker = zlib.decompressobj(_GZIP)
    try:
        first = unpacker.decompress(data, _LEGACY_HEADER.size)
        if len(first) < _LEGACY_HEADER.size:
            raise UsageError("is damaged: it ends within its header; export it again")
        head = _checked(list(_LEGACY_HEADER.unpack(first))[:6], (2, 3))
        room.check(head.count, head.coefficients, len(data))
        size = sum(head.sizes)
        raw = unpacker.decompress(unpacker.unconsumed_tail, size) if size else b""
    except zlib.error:
        raise UsageError("is damaged: its gzip cannot be unpacked; export it again") from None
    if len(raw) < size:
        raise UsageError(
            f"is cut off: {head.count} Gaussians take {size} bytes, and {len(raw)} are there; export it again"
        )
    return head, raw


def _unzstd(packed: bytes, size: int) -> bytes:
    """Exactly so many bytes, whatever the frame says of itself."""
    try:
        with zstandard.ZstdDecompressor(max_window_size=_LARGEST_WINDOW).stream_reader(packed) as reader:
            raw: bytes = reader.read(size)
    except zstandard.ZstdError:
        raise UsageError("is damaged: a stream's zstd cannot be unpacked; export it again") from None
    if len(raw) < size:
        raise UsageError("is damaged: a stream is shorter than it says; export it again")
    return raw


def _checked(fields: list[int], versions: tuple[int, ...]) -> _Head:
    magic, version, count, degree, fraction_bits, flags = fields
    head = _Head(version, count, degree, fraction_bits, flags)
    if magic != _MAGIC:
        raise UsageError("is no .spz; export it again")
    if head.version not in versions:
        raise UsageError(f"is .spz version {head.version} in a wrapper of others; versions 2, 3 and 4 are read")
    if head.degree > 3:
        raise UsageError(f"has SH degree {head.degree}; degrees 0 to 3 are read")
    if head.fraction_bits > _LARGEST_FRACTION:
        raise UsageError(f"is damaged: positions have {head.fraction_bits} fraction bits; export it again")
    return head


def _first_three(rotations: FloatArray) -> NDArray[np.uint8]:
    """Version 2: x, y, z of the quaternion whose w is not negative."""
    turned = rotations * np.where(rotations[:, :1] < 0, -1, 1)
    return to_bytes(turned[:, 1:] * np.float32(127.5) + np.float32(127.5))


def _from_first_three(codes: NDArray[np.uint8]) -> NDArray[np.float64]:
    xyz = codes / 127.5 - 1
    w = np.sqrt(np.maximum(0, 1 - (xyz**2).sum(axis=1, keepdims=True)))
    return np.concatenate([w, xyz], axis=1)


def _fixed_point(means: FloatArray, fraction_bits: int) -> NDArray[np.uint8]:
    bound = 1 << 23
    points = np.clip(np.rint(means.astype(np.float64) * (1 << fraction_bits)), -bound, bound - 1).astype("<i4")
    return np.ascontiguousarray(points.view(np.uint8).reshape(len(means), 3, 4)[..., :3])


def _from_fixed_point(data: NDArray[np.uint8], fraction_bits: int) -> NDArray[np.float64]:
    wide = np.zeros((len(data), 3, 4), np.uint8)
    wide[..., 1:] = data.reshape(len(data), 3, 3)
    # The three bytes stand highest, so that the shift brings the sign along.
    points = wide.view("<i4")[..., 0] >> 8
    return np.asarray(points / (1 << fraction_bits), np.float64)


def _smallest_three(rotations: FloatArray) -> NDArray[np.uint32]:
    """Number of the largest component, then a sign and nine bits for each of the others, x, y, z, w."""
    xyzw = np.roll(rotations, -1, axis=1)
    row = np.arange(len(xyzw))
    largest = np.abs(xyzw).argmax(axis=1)
    xyzw = xyzw * np.where(xyzw[row, largest] < 0, -1, 1)[:, None]
    packed = largest.astype("<u4")
    for i in range(4):
        magnitude = (np.abs(xyzw[:, i]) / _LARGEST * _MAGNITUDE + 0.5).astype("<u4")
        code = (xyzw[:, i] < 0).astype("<u4") << np.uint32(9) | magnitude
        packed = np.where(largest == i, packed, packed << np.uint32(10) | code)
    return np.asarray(packed, "<u4")


def _from_smallest_three(packed: NDArray[np.uint32]) -> NDArray[np.float64]:
    largest = (packed >> np.uint32(30)).astype(np.int64)
    xyzw = np.zeros((len(packed), 4))
    left = packed.copy()
    for i in (3, 2, 1, 0):
        value = (left & np.uint32(_MAGNITUDE)) / _MAGNITUDE * _LARGEST
        value = np.where(left >> np.uint32(9) & np.uint32(1), -value, value)
        xyzw[:, i] = np.where(largest == i, 0, value)
        left = np.where(largest == i, left, left >> np.uint32(10))
    xyzw[np.arange(len(packed)), largest] = np.sqrt(np.maximum(0, 1 - (xyzw**2).sum(axis=1)))
    return np.roll(xyzw, 1, axis=1)


def _bucketed(sh: FloatArray, bucket: NDArray[np.int64]) -> NDArray[np.uint8]:
    """128ths of a unit around 128, the lower bits rounded away: they stay in their byte, and gzip finds them."""
    whole = np.rint(sh.astype(np.float64) * 128).astype(np.int64) + 128
    return np.asarray(np.clip((whole + bucket // 2) // bucket * bucket, 0, 255), np.uint8)


Format = Spz
