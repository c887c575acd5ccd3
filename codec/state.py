"""The decoder's state: every Gaussian as integers on the lattice (SPEC.md, "State").

Arrays of a State are read-only and may be shared between successive states: a delta copies only what it changes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import sh_degree_of

IntArray = NDArray[np.int32]
Rows = NDArray[np.int64]

GROUPS = ("means", "log_scales", "quaternions", "opacity_logits", "sh_dc", "sh_rest")
"""The attribute groups in wire order; bit g of a presence byte stands for GROUPS[g]."""

DEFAULT_MAX_GAUSSIANS = 1 << 21
"""What a reader accepts unless told otherwise; bounds the memory a hostile stream can claim (SPEC.md, "Limits")."""

MAX_GAUSSIANS = 1 << 27
"""What the format allows."""

MAX_ID = (1 << 63) - 1

_Attributes = TypeVar("_Attributes", bound="Attributes")


@dataclass(frozen=True, eq=False)
class Attributes:
    """N Gaussians as lattice integers, int32, C-contiguous; shapes as in Splats."""

    means: IntArray
    log_scales: IntArray
    quaternions: IntArray
    opacity_logits: IntArray
    sh: IntArray

    def __len__(self) -> int:
        return int(self.means.shape[0])

    @property
    def coefficients(self) -> int:
        """SH coefficients per colour channel, (degree + 1)**2."""
        return int(self.sh.shape[1])


@dataclass(frozen=True, eq=False)
class State(Attributes):
    """The scene after a frame. Rows are ordered by strictly increasing ``ids`` (int64), which no later Gaussian reuses.

    ``next_id`` is the id of the next Gaussian to appear, ``frame`` the frame's index, ``row_sum`` the sum of the row
    hashes modulo 2**64 from which the digest comes. Build one with ``new_state``: ``row_sum`` must fit the arrays.
    """

    ids: Rows
    next_id: int
    frame: int
    row_sum: int


def group_channels(coefficients: int) -> dict[str, int]:
    """Number of channels of each attribute group; sh_rest has none at degree 0."""
    return dict(zip(GROUPS, (3, 3, 4, 1, 3, 3 * (coefficients - 1)), strict=True))


def group_columns(attributes: Attributes, group: str) -> IntArray:
    """One attribute group as a view (N, channels); sh_rest runs over coefficients, then colours."""
    n = len(attributes)
    if group == "sh_dc":
        return attributes.sh[:, 0, :]
    if group == "sh_rest":
        return attributes.sh[:, 1:, :].reshape(n, 3 * (attributes.coefficients - 1))
    columns: IntArray = getattr(attributes, group)
    return columns[:, None] if group == "opacity_logits" else columns


def attributes_from_columns(columns: Mapping[str, IntArray], count: int, coefficients: int) -> Attributes:
    """Attributes from (count, channels) arrays per group; a group that is absent is zero."""
    widths = group_channels(coefficients)
    full = {g: columns[g] if g in columns else np.zeros((count, widths[g]), np.int32) for g in GROUPS}
    sh = np.empty((count, coefficients, 3), np.int32)
    sh[:, 0] = full["sh_dc"]
    sh[:, 1:] = full["sh_rest"].reshape(count, coefficients - 1, 3)
    return Attributes(
        np.ascontiguousarray(full["means"]),
        np.ascontiguousarray(full["log_scales"]),
        np.ascontiguousarray(full["quaternions"]),
        np.ascontiguousarray(full["opacity_logits"][:, 0]),
        sh,
    )


def empty_attributes(coefficients: int) -> Attributes:
    """No Gaussians at all."""
    return attributes_from_columns({}, 0, coefficients)


def take_rows(attributes: Attributes, rows: NDArray[Any]) -> Attributes:
    """The Gaussians at the indices ``rows``, in that order, without their ids."""
    # ndarray.take is several times faster than indexing here.
    return Attributes(
        attributes.means.take(rows, axis=0),
        attributes.log_scales.take(rows, axis=0),
        attributes.quaternions.take(rows, axis=0),
        attributes.opacity_logits.take(rows, axis=0),
        attributes.sh.take(rows, axis=0),
    )


def join_rows(first: Attributes, second: Attributes) -> Attributes:
    """The Gaussians of both, ``second``'s behind ``first``'s, without their ids."""
    names = ("means", "log_scales", "quaternions", "opacity_logits", "sh")
    return Attributes(*(np.concatenate([getattr(first, name), getattr(second, name)]) for name in names))


def check_shapes(attributes: Attributes) -> None:
    """Raises ValueError unless the arrays are int32 of one length and of the shapes of Splats."""
    n, k = len(attributes), attributes.coefficients
    sh_degree_of(k)
    shapes = {"means": (n, 3), "log_scales": (n, 3), "quaternions": (n, 4), "opacity_logits": (n,), "sh": (n, k, 3)}
    for name, shape in shapes.items():
        array = getattr(attributes, name)
        if array.shape != shape or array.dtype != np.int32:
            raise ValueError(f"{name} is {array.dtype} {array.shape}, not int32 {shape}")


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """The same array behind a view that cannot be written."""
    view: NDArray[Any] = np.ascontiguousarray(array).view()
    view.flags.writeable = False
    return view
