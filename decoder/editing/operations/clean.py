"""``clean``: leaves out what floats where nothing is, by what it is and by what the rig's cameras see."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from decogs.codec.header.header import StreamHeader
from decogs.codec.scene.lattice import LOG_SCALE_BOUND, dequantise
from decogs.codec.scene.state import Rows, State, part_of
from decogs.formats.cameras import project
from decogs.formats.cli.command_line import Parser, number, whole_number
from decogs.formats.errors import UsageError
from decogs.formats.geometry.similarity import transformed_splats
from decogs.formats.splats import SH_C0, Splats, sigmoid

from ...reading.stream import in_its_world
from ..scene import positions
from ..segments import rows_among, with_choices
from ..take import Frame, Take
from .base import Opener, Operation

_MARGIN = 0.15
"""Of a picture's side, by which a camera sees more than its pinhole does: a lens bends some of it in."""

_REACH = 3.0
"""Sigmas at which a Gaussian ends."""

_NEIGHBOURS = 3
"""Others within the distance that a Gaussian needs not to be alone."""

_CELLS = 1 << 20
"""Along each axis, in which neighbours are looked for."""

_SHOWN_OPACITY_LOGIT = 3.0
_RED = np.array([0.5, -0.5, -0.5]) / SH_C0
_DIMMED = 0.35


@dataclass(frozen=True)
class Clean(Operation):
    """Leaves out Gaussians for which one of these holds in every frame of a segment in which they are.

    ``opacity``: it is below this. ``size``: its longest semi-axis of one sigma is above this, world units.
    ``isolation``: it is smaller than cells of this side, world units, and fewer than three others are in those around
    it. ``seen``: fewer of the rig's cameras than this have any of it in their picture, hidden or not. None: it does not
    count; where all are None, opacity below .01, no camera, and isolation in cells of 1/50 of the scene. ``picture``: a
    PNG of the first frame from the first view, what goes in red.
    """

    opacity: float | None = None
    size: float | None = None
    isolation: float | None = None
    seen: int | None = None
    picture: Path | None = None
    name = "clean"
    summary = "leave out floaters, by opacity, size, isolation and what the rig's cameras see"

    @property
    def outputs(self) -> tuple[Path, ...]:
        """The picture."""
        return () if self.picture is None else (self.picture,)

    def edit(self, take: Take, open_other: Opener) -> Take:
        """The same frames of fewer Gaussians; what stays keeps its bits. Raises UsageError for limits that are none."""
        given = {name: getattr(self, name) for name in ("opacity", "size", "isolation", "seen")}
        if any(value is not None and not 0 < value < 1e12 for value in given.values()):
            raise UsageError("clean: give limits above 0")
        if self.opacity is not None and self.opacity > 1:
            raise UsageError(f"clean: an opacity is at most 1, not {self.opacity:g}")
        if self.picture is not None and self.picture.suffix.lower() != ".png":
            raise UsageError(f"clean: {self.picture}: the picture is a PNG; name it so")
        header = in_its_world(take.header)
        limits = {name: value for name, value in given.items() if value is not None} or _usual(take, header)
        chosen = with_choices(take, lambda state: list(_kept(header, state, limits).values()))
        lines: list[str] = []

        def read(start: int, stop: int) -> Iterator[Frame]:
            for frame, ids in chosen(start, stop):
                stays = _in_all(frame.state, ids)
                if not lines:
                    lines.append(_summary(frame.state, ids, limits, stays))
                    if self.picture is not None:
                        _write_picture(header, frame.state, stays, self.picture)
                yield frame if stays.all() else frame.of(part_of(frame.state, stays))

        return replace(take, read=read).with_note(lambda: lines[0])

    @staticmethod
    def add_options(parser: Parser) -> None:
        """The limits, and the picture."""
        parser.add_argument("--opacity", type=number, metavar="O", help="goes when its opacity stays below this (.01)")
        parser.add_argument(
            "--size", type=number, metavar="S", help="goes when its sigma stays above this, world units"
        )
        parser.add_argument(
            "--isolation",
            type=number,
            metavar="D",
            help="goes with fewer than 3 others in cells of this side around it",
        )
        parser.add_argument(
            "--seen", type=whole_number, metavar="N", help="goes when fewer of the rig's cameras can see it (1)"
        )
        parser.add_argument(
            "--picture", type=Path, metavar="X.PNG", help="the first frame, what goes in red; also with --dry-run"
        )

    @classmethod
    def of_options(cls, options: argparse.Namespace) -> Clean:
        """Of the options as they are named."""
        return cls(**vars(options))


def _usual(take: Take, header: StreamHeader) -> dict[str, float]:
    points = positions(header, next(take.read(0, 1)).state)
    if not len(points):
        raise UsageError("clean: the first frame has no Gaussian; give limits")
    low, high = np.percentile(points, [2, 98], axis=0)
    return {"opacity": 0.01, "isolation": max(float((high - low).max()) / 50, 1e-9), "seen": 1}


def _kept(header: StreamHeader, state: State, limits: dict[str, float]) -> dict[str, NDArray[np.bool_]]:
    """By limit, the Gaussians (N,) that keep to it in this frame."""
    points, sizes = positions(header, state), _sizes(header, state)
    kept: dict[str, NDArray[np.bool_]] = {}
    for name, limit in limits.items():
        if name == "opacity":
            kept[name] = sigmoid(state.opacity_logits * np.float64(header.lattice.opacity_logits)) >= limit
        elif name == "size":
            kept[name] = sizes <= limit
        elif name == "isolation":
            kept[name] = (_neighbours(points, limit) >= _NEIGHBOURS) | (sizes > limit)
        else:
            kept[name] = _views(header, points, sizes) >= limit
    return kept


def _sizes(header: StreamHeader, state: State) -> NDArray[np.float64]:
    """The longest semi-axis of each Gaussian, one sigma, world units."""
    logs = np.clip(state.log_scales * np.float64(header.lattice.log_scales), -LOG_SCALE_BOUND, LOG_SCALE_BOUND)
    return np.asarray(header.presentation.similarity.scale * np.exp(logs).max(axis=1, initial=0))


def _neighbours(points: NDArray[np.float64], side: float) -> NDArray[np.int64]:
    """How many others are in the cell of each place (N, 3) and in the 26 around it."""
    if not len(points):
        return np.zeros(0, np.int64)
    cells = np.clip((points - points.min(axis=0)) / side, 0, _CELLS - 2).astype(np.int64) + 1
    weights = np.array([1, _CELLS + 1, (_CELLS + 1) ** 2])
    keys, which, counts = np.unique(cells @ weights, return_inverse=True, return_counts=True)
    around = np.zeros(len(keys), np.int64)
    for offset in product((-1, 0, 1), repeat=3):
        wanted = keys + int(np.array(offset) @ weights)
        rows = np.searchsorted(keys, wanted).clip(max=len(keys) - 1)
        around += np.where(keys[rows] == wanted, counts[rows], 0)
    return np.asarray(around[which.reshape(-1)] - 1)


def _views(header: StreamHeader, points: NDArray[np.float64], sizes: NDArray[np.float64]) -> NDArray[np.int64]:
    """How many cameras have any of the Gaussians at each place (N, 3), of sizes (N,), in their picture."""
    count = np.zeros(len(points), np.int64)
    for camera in header.cameras:
        u, v, depth = project(camera, points)
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = _REACH * sizes / np.maximum(depth, 0)
        across, down = _MARGIN * camera.width + camera.fx * reach, _MARGIN * camera.height + camera.fy * reach
        count += (
            (depth > camera.near)
            & (u >= -across)
            & (u < camera.width + across)
            & (v >= -down)
            & (v < camera.height + down)
        )
    return count


def _in_all(state: State, ids: tuple[Rows, ...]) -> NDArray[np.bool_]:
    return np.asarray(np.logical_and.reduce([rows_among(state, each) for each in ids]))


def _summary(state: State, ids: tuple[Rows, ...], limits: dict[str, float], stays: NDArray[np.bool_]) -> str:
    """What goes of the first frame, and for which reasons."""
    reasons = [
        f"{len(state) - int(rows_among(state, each).sum())} by {name} ({limit:.3g})"
        for (name, limit), each in zip(limits.items(), ids, strict=True)
    ]
    gone = len(state) - int(stays.sum())
    return f"clean: {gone} of {len(state)} Gaussians of the first frame go: {', '.join(reasons)}"


def _write_picture(header: StreamHeader, state: State, stays: NDArray[np.bool_], path: Path) -> None:
    """The scene dimmed and grey, what goes in red; small and thin ones as opaque as they must be to show."""
    from ...output.pictures import open_sink
    from ...output.video import VideoSettings
    from ...rendering.views import render_view

    splats = transformed_splats(dequantise(state, header.lattice), header.presentation.similarity)
    view = header.presentation.first_view or header.cameras[0].name
    picture = render_view(header, _marked(splats, ~stays), view)
    with open_sink(path, view=view, frames=1, fps=None, video=VideoSettings(), cut_out=False) as sink:
        sink.write(0, picture)


def _marked(splats: Splats, gone: NDArray[np.bool_]) -> Splats:
    sh = np.zeros_like(splats.sh)
    grey = splats.sh[:, :1].mean(axis=2, keepdims=True)
    sh[:, :1] = _DIMMED * grey - (1 - _DIMMED) * 0.5 * _DIMMED / SH_C0
    sh[gone, 0] = _RED
    opacity_logits = np.where(gone, np.maximum(splats.opacity_logits, _SHOWN_OPACITY_LOGIT), splats.opacity_logits)
    return replace(splats, sh=sh, opacity_logits=opacity_logits.astype(np.float32))
