""".sog: textures of 8 bits in lossless WebP and a ``meta.json``, in one ZIP; version 2.

Source: PlayCanvas, "The SOG Format" (developer.playcanvas.com, of autumn 2026). Axes are those of .ply: PlayCanvas' own
converter passes their numbers on, whatever that page says of up.
"""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from ..splats import FloatArray, Splats
from . import ANY_SIZE, Extremes, needs_gaussians
from .quantised import logits, opacities, to_bytes, unit_rotations

Bytes = NDArray[np.uint8]
Doubles = NDArray[np.float64]

_ENTRIES = 256
_PALETTE_ROW = 64
_LARGEST_PALETTE = 1 << 16
_MORTON_BITS = 10
_LARGEST_COORDINATE = 65535
_FIRST_LARGEST = 252
"""In a rotation's alpha: w is the largest component; x, y and z follow."""
_OTHERS = ((1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2))
_REST = (0, 3, 8, 15)
"""Higher SH coefficients per channel, by degree."""
_BINS = 4096
_SETTLING = 30
_EARLIEST = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True)
class Sog:
    """One frame: 16 bits for a coordinate's logarithm, 8 for all else.

    Sizes, base colours and higher SH coefficients each share 256 values that suit the frame; of the higher SH at most
    65 536 sets are kept. Gaussians come in Morton order, which WebP codes shortest. ``compensated`` stands in
    ``model`` and, for readers of early 2026, in ``antialias``.
    """

    compensated: bool = False
    suffix: ClassVar[str] = ".sog"
    up: ClassVar[Literal["Y", "-Y"]] = "-Y"
    log_scales: ClassVar[tuple[float, float]] = ANY_SIZE

    def fitted(self, extremes: Extremes) -> tuple[Sog, list[str]]:
        needs_gaussians(extremes, self.suffix)
        return self, []

    def encode(self, splats: Splats) -> bytes:
        order = _morton_order(splats.means)
        low, high, bounds = _coordinates(splats.means[order])
        sizes, size_labels = _codebook(splats.log_scales[order])
        colours, colour_labels = _codebook(splats.sh[order, 0])
        alpha = to_bytes(opacities(splats)[order] * np.float32(255))[:, None]
        images = {
            "means_l": _image(low),
            "means_u": _image(high),
            "scales": _image(size_labels),
            "quats": _image(_rotations(unit_rotations(splats)[order])),
            "sh0": _image(np.concatenate([colour_labels, alpha], axis=1)),
        }
        meta: dict[str, Any] = {
            "version": 2,
            "asset": {"generator": "decogs"},
            "count": len(splats),
            **({"model": "antialiased", "antialias": True} if self.compensated else {}),
            "means": bounds | _files("means_l", "means_u"),
            "scales": {"codebook": sizes} | _files("scales"),
            "quats": _files("quats"),
            "sh0": {"codebook": colours} | _files("sh0"),
        }
        if splats.sh_degree:
            meta["shN"], more = _higher(splats.sh[order, 1:], splats.sh_degree)
            images |= more
        return _bundle(meta, images)

    def decode(self, data: bytes) -> Splats:
        with zipfile.ZipFile(io.BytesIO(data)) as bundle:
            meta = json.loads(bundle.read("meta.json"))
            count = meta["count"]

            def pixels(kind: str, number: int = 0) -> Bytes:
                return _pixels(bundle.read(meta[kind]["files"][number]))

            levels = pixels("means")[:count, :3] + 256.0 * pixels("means", 1)[:count, :3]
            first, last = np.array(meta["means"]["mins"]), np.array(meta["means"]["maxs"])
            logarithms = first + (last - first) * levels / _LARGEST_COORDINATE
            base = pixels("sh0")[:count]
            sh = np.array(meta["sh0"]["codebook"])[base[:, None, :3]]
            if "shN" in meta:
                rest, coefficients = meta["shN"], _REST[meta["shN"]["bands"]]
                palette = np.array(rest["codebook"])[pixels("shN")[:, :3]].reshape(-1, coefficients, 3)
                labels = pixels("shN", 1)[:count].astype(np.int64)
                sh = np.concatenate([sh, palette[labels[:, 0] + 256 * labels[:, 1]]], axis=1)
            arrays = (
                np.sign(logarithms) * np.expm1(np.abs(logarithms)),
                np.array(meta["scales"]["codebook"])[pixels("scales")[:count, :3]],
                _from_smallest_three(pixels("quats")[:count]),
                logits(base[:, 3] / np.float32(255)),
                sh,
            )
        return Splats(*(np.ascontiguousarray(array, np.float32) for array in arrays))


def _files(*names: str) -> dict[str, list[str]]:
    return {"files": [f"{name}.webp" for name in names]}


def _bundle(meta: dict[str, Any], images: dict[str, bytes]) -> bytes:
    """The same contents make the same bytes. Nothing is deflated: WebP is as small as it gets."""
    members = {"meta.json": json.dumps(meta, separators=(",", ":")).encode()}
    members |= {f"{name}.webp": image for name, image in images.items()}
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as bundle:
        for name, data in members.items():
            bundle.writestr(zipfile.ZipInfo(name, _EARLIEST), data)
    return file.getvalue()


def _image(rows: Bytes, width: int = 0) -> bytes:
    """A lossless WebP whose pixels, from the top left on, are the rows (N, 2), (N, 3) or (N, 4); the last are spare."""
    from PIL import Image

    width = width or -(-int(np.ceil(np.sqrt(len(rows)))) // 4) * 4
    height = -(-len(rows) // width)
    image = np.zeros((height * width, 4), np.uint8)
    image[:, 3] = 255
    image[: len(rows), : rows.shape[1]] = rows
    file = io.BytesIO()
    # Pixels of alpha 0 lose their colour, and so do Gaussians of opacity 0.
    Image.fromarray(image.reshape(height, width, 4)).save(file, "webp", lossless=True)
    return file.getvalue()


def _pixels(data: bytes) -> Bytes:
    """RGBA, (N, 4), from the top left on."""
    from PIL import Image

    with Image.open(io.BytesIO(data)) as image:
        return np.asarray(image.convert("RGBA"), np.uint8).reshape(-1, 4)


def _coordinates(means: FloatArray) -> tuple[Bytes, Bytes, dict[str, list[float]]]:
    """Low and high bytes of the places, whose logarithms are steps from one bound to the other."""
    values = means.astype(np.float64)
    logarithms = np.sign(values) * np.log1p(np.abs(values))
    first, last = logarithms.min(axis=0), logarithms.max(axis=0)
    span = np.where(last > first, last - first, 1)
    levels = np.rint((logarithms - first) / span * _LARGEST_COORDINATE).astype(np.uint16)
    bounds = {"mins": first.tolist(), "maxs": last.tolist()}
    return (levels & 255).astype(np.uint8), (levels >> 8).astype(np.uint8), bounds


def _rotations(quaternions: FloatArray) -> Bytes:
    """The three smaller components, from -1/sqrt(2) to 1/sqrt(2), and which one they leave out, made positive."""
    largest = np.abs(quaternions).argmax(axis=1)
    row = np.arange(len(quaternions))
    signs = np.where(quaternions[row, largest] < 0, -1, 1)[:, None]
    smaller = (quaternions * signs)[row[:, None], np.array(_OTHERS)[largest]]
    levels = to_bytes(np.asarray((smaller * np.sqrt(0.5) + 0.5) * 255, np.float32))
    return np.concatenate([levels, (_FIRST_LARGEST + largest).astype(np.uint8)[:, None]], axis=1)


def _from_smallest_three(pixels: Bytes) -> Doubles:
    largest = pixels[:, 3].astype(np.int64) - _FIRST_LARGEST
    row = np.arange(len(pixels))
    smaller = (pixels[:, :3] / 255 * 2 - 1) * np.sqrt(0.5)
    quaternions = np.zeros((len(pixels), 4))
    quaternions[row[:, None], np.array(_OTHERS)[largest]] = smaller
    quaternions[row, largest] = np.sqrt(np.maximum(0, 1 - (smaller**2).sum(axis=1)))
    return quaternions


def _codebook(values: FloatArray) -> tuple[list[float], Bytes]:
    """256 rising values, and for each number, of any shape, which of them is the nearest.

    Where numbers lie close, so do the values: in one dimension the least square error wants the cube root of the
    density (Panter and Dite, 1951). From there Lloyd's iterations; the same numbers give the same values.
    """
    distinct, counts = np.unique(values.astype(np.float64), return_counts=True)
    if len(distinct) <= _ENTRIES:
        book = np.pad(distinct, (0, _ENTRIES - len(distinct)), mode="edge")
        return book.tolist(), np.searchsorted(distinct, values.astype(np.float64)).astype(np.uint8)
    histogram, edges = np.histogram(distinct, _BINS, weights=counts.astype(np.float64))
    grown = np.concatenate([[0], np.cumsum(np.cbrt(histogram))])
    book = np.interp((np.arange(_ENTRIES) + 0.5) / _ENTRIES * grown[-1], grown, edges)
    mass, moment = (np.concatenate([[0], np.cumsum(array)]) for array in (counts, counts * distinct))
    for _ in range(_SETTLING):
        ends = np.concatenate([[0], np.searchsorted(distinct, _midpoints(book)), [len(distinct)]])
        held = np.diff(mass[ends])
        book = np.where(held > 0, np.diff(moment[ends]) / np.maximum(held, 1), book)
    book = np.sort(book).astype(np.float32).astype(np.float64)
    return book.tolist(), np.searchsorted(_midpoints(book), values).astype(np.uint8)


def _midpoints(book: Doubles) -> Doubles:
    return np.asarray((book[1:] + book[:-1]) / 2)


def _higher(sh: FloatArray, degree: int) -> tuple[dict[str, Any], dict[str, bytes]]:
    """SH coefficients (N, K, 3) above degree 0: what ``meta.json`` says of them, and their two images."""
    palette, labels = _palette(sh.reshape(len(sh), -1))
    book, entries = _codebook(palette)
    label_bytes = np.stack([labels & 255, labels >> 8, np.zeros_like(labels)], axis=1).astype(np.uint8)
    images = {
        "shN_centroids": _image(entries.reshape(-1, 3), _PALETTE_ROW * sh.shape[1]),
        "shN_labels": _image(label_bytes),
    }
    meta = {"count": len(palette), "bands": degree, "codebook": book} | _files("shN_centroids", "shN_labels")
    return meta, images


def _palette(rows: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """At most 65 536 rows that stand for all, and which of them stands for each.

    Up to that many Gaussians each row stands for itself. Beyond, groups are halved again and again across the
    coefficient that varies most in them, and means stand for groups.
    """
    count = len(rows)
    if count <= _LARGEST_PALETTE:
        return rows, np.arange(count)
    order, starts = np.arange(count), np.array([0])
    while len(starts) < _LARGEST_PALETTE:
        sizes = np.diff(np.append(starts, count))
        group = np.repeat(np.arange(len(starts)), sizes)
        held = rows[order].astype(np.float64)
        means = np.add.reduceat(held, starts) / sizes[:, None]
        varied = np.add.reduceat((held - means[group]) ** 2, starts).argmax(axis=1)
        order = order[np.lexsort((held[np.arange(count), varied[group]], group))]
        starts = np.stack([starts, starts + sizes // 2], axis=1).ravel()
    sizes = np.diff(np.append(starts, count))
    labels = np.empty(count, np.int64)
    labels[order] = np.repeat(np.arange(len(starts)), sizes)
    means = np.add.reduceat(rows[order].astype(np.float64), starts) / sizes[:, None]
    return means.astype(np.float32), labels


def _morton_order(means: FloatArray) -> NDArray[np.int64]:
    """Rows such that neighbours in space are neighbours; rows of one of 1024 x 1024 x 1024 cells keep their order."""
    values = means.astype(np.float64)
    first, last = values.min(axis=0), values.max(axis=0)
    cells = ((values - first) / np.where(last > first, last - first, 1) * ((1 << _MORTON_BITS) - 1)).astype(np.int64)
    codes = np.zeros(len(means), np.int64)
    for bit in range(_MORTON_BITS):
        for axis in range(3):
            codes |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
    return np.argsort(codes, kind="stable")


Format = Sog
