"""Decoded frames as one USD file: finds which Gaussians ever change and writes those apart from the others.

The layout and its reasons are described in ``formats.usd.writing``. Frames are read twice, one at a time; memory holds
a few copies of one frame (and, for a .usda, the whole file).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera
from decogs.formats.colours.srgb import linear_from_srgb
from decogs.formats.errors import UsageError
from decogs.formats.geometry.similarity import NO_CHANGE, Similarity
from decogs.formats.splat_files.quantised import unit_rotations
from decogs.formats.splats import SH_C0, Splats, empty_splats, join_splats, sigmoid, take_splats
from decogs.formats.usd.prims import Flavour, UsdSplats, just_before
from decogs.formats.usd.writing import DEFAULT_PROTOTYPE_RADIUS, UsdWriter, check_usd_request

Ids = NDArray[np.int64]
Mask = NDArray[np.bool_]

STATIC_GROUP, RESTING_GROUP, DYNAMIC_GROUP = "Static", "Resting", "Dynamic"

SEGMENT = 4
"""Frames for which the rows of the group that moves stay. A segment writes one more frame than it has: fewer frames
write that more often, more frames write more rows that move for a few of them."""

NEST = 2
"""Segments that a longer one has, and that as many of those, and so on: what rests in all of them is written once for
all. Of 80 frames in which motion sweeps over everything (`a_long_take` of the tests), 8 frames without longer segments
took 3.5 MB, with them 3.2; 4 frames take 2.2. Three lengths in one take 2.4, and 3 frames 2.0 with more groups."""


@dataclass(frozen=True)
class ExportFrame:
    """One decoded frame: time index, stable ids (N,) int64, all different and in any order, and their splats."""

    index: int
    ids: Ids
    splats: Splats


@dataclass(frozen=True)
class UsdReport:
    """What a USD file holds: frames, Gaussians that never and that ever change; and its bytes."""

    frame_count: int
    static_count: int
    dynamic_count: int
    file_bytes: int


@dataclass(frozen=True)
class Census:
    """Who lives and who changes over all frames of an export; id arrays sorted, splats in the same order.

    Static: alive in every frame and never changed; ``static`` are their values. Dynamic: every other Gaussian that is
    ever alive; ``newborn`` are their values when they first appear. SH is cut to what the prims can hold.

    ``touched``: for each `SEGMENT` of frames, who changes, appears or vanishes from its first frame to the next one's.
    """

    frames: tuple[int, ...]
    static_ids: Ids
    static: Splats
    dynamic_ids: Ids
    newborn: Splats
    touched: tuple[Ids, ...]


def export_usd(
    frames: Callable[[], Iterable[ExportFrame]],
    path: str | Path,
    *,
    fps: float,
    cameras: Sequence[Camera] = (),
    root: Similarity = NO_CHANGE,
    prototype_radius: float = DEFAULT_PROTOTYPE_RADIUS,
    documentation: str = "",
    flavour: Flavour = "instancer",
    asset: tuple[str, str] | None = None,
    velocities: bool = False,
) -> UsdReport:
    """A stream of decoded frames as USD: /World/Static, /World/Dynamic, their points, and the rig's cameras.

    ``frames`` is called twice and gives the same frames both times, indices rising; indices become time codes.
    ``prototype_radius`` is the size of a drawn ellipsoid in standard deviations. ``root`` brings the world to Y up and
    metres. ``documentation`` goes into the file (source and licence of the footage). ``flavour``: as instancers with
    points, as splat prims, which hold all SH, or as both. ``asset``: name and version, for asset managers.
    ``velocities``: instances that move have them, as far as the next frame tells.

    A group without Gaussians is left out. Raises UsageError for a name that is not USD's, without frames, and when the
    file cannot be written; a file of that name is only ever replaced by a complete one.
    """
    path = Path(path)
    check_usd_request(path, fps=fps, prototype_radius=prototype_radius)
    census = take_census(frames(), view_dependent=flavour != "instancer")
    if not census.frames:
        raise UsageError(f"{path}: there is no frame to export; choose frames that the stream has")
    with UsdWriter(
        path,
        fps=fps,
        frames=(census.frames[0], census.frames[-1]),
        root=root,
        prototype_radius=prototype_radius,
        documentation=documentation,
        flavour=flavour,
        asset=asset,
    ) as usd:
        usd.add_cameras(cameras)
        if len(census.static_ids):
            usd.add_group(STATIC_GROUP, census.static_ids)
            usd.write_frame(STATIC_GROUP, census.frames[0], usd_splats(census.static))
        if len(census.dynamic_ids):
            _write_dynamic(usd, census, frames(), fps if velocities else None)
    return UsdReport(len(census.frames), len(census.static_ids), len(census.dynamic_ids), path.stat().st_size)


def take_census(frames: Iterable[ExportFrame], *, view_dependent: bool = False) -> Census:
    """First reading: which stable ids change, appear or vanish. Values are compared bit for bit as stored.

    ``view_dependent``: SH beyond degree 0 count and are kept, as splat prims can hold them. Raises
    ValueError when indices do not rise or an id occurs twice in a frame.
    """
    indices: list[int] = []
    previous: ExportFrame | None = None
    all_ids = np.zeros(0, np.int64)
    all_splats: Splats | None = None
    touched: list[Ids] = []
    for raw in frames:
        _check_order(indices, raw.index)
        # The step to the first frame of a segment belongs to the one before.
        if not touched or (len(indices) > 1 and (len(indices) - 1) % SEGMENT == 0):
            touched.append(np.zeros(0, np.int64))
        indices.append(raw.index)
        if previous is not None and raw.splats is previous.splats and raw.ids is previous.ids:
            continue
        frame = _sorted_by_id(raw, view_dependent=view_dependent)
        if previous is None or all_splats is None:
            all_ids, all_splats = frame.ids, frame.splats
        else:
            touched[-1] = np.union1d(touched[-1], _touched(previous, frame))
            fresh = ~np.isin(frame.ids, all_ids, assume_unique=True)
            if fresh.any():
                all_ids = np.concatenate([all_ids, frame.ids[fresh]])
                all_splats = join_splats(all_splats, take_splats(frame.splats, fresh))
        previous = frame
    if all_splats is None:
        return Census((), all_ids, empty_splats(0), all_ids, empty_splats(0), ())
    order = np.argsort(all_ids)
    all_ids, all_splats = all_ids[order], take_splats(all_splats, order)
    changes = np.isin(all_ids, np.concatenate(touched))
    return Census(
        tuple(indices),
        all_ids[~changes],
        take_splats(all_splats, ~changes),
        all_ids[changes],
        take_splats(all_splats, changes),
        tuple(touched),
    )


@dataclass(frozen=True)
class Rows:
    """A group's rows at a time: stable ids, values, which are alive, and until when nothing changes, if known."""

    group: str
    time: float
    ids: Ids
    splats: UsdSplats
    alive: Mask
    until: float | None = None


def follow_dynamic(census: Census, frames: Iterable[ExportFrame], fps: float | None = None) -> Iterator[Rows]:
    """Second reading: the Gaussians that ever change, segment by segment, those that rest in it apart from the others.

    A Gaussian has its first values before it appears and its last ones after it vanished, within a segment. A segment
    ends just before the next one's first frame, with the values of that frame. Arrays that did not change are the same
    objects as before. ``fps``: for velocities of those that move, or None.
    """
    moving: _Moving | None = None
    resting = _Resting(census)
    for number, (frame, following) in enumerate(_with_following(frames)):
        if moving is not None:
            moving.show(frame)
        if number % SEGMENT == 0:
            if moving is not None:
                yield moving.rows(just_before(frame.index))
            yield from resting.begin(number, frame)
            ids = resting.movers(number, frame)
            moving = _Moving(ids, _at_ids(census, ids))
            moving.show(frame)
        assert moving is not None
        if fps is not None:
            moving.head_for(following, fps)
        yield moving.rows(frame.index)


def _with_following(frames: Iterable[ExportFrame]) -> Iterator[tuple[ExportFrame, ExportFrame | None]]:
    """Each frame with the next one, the last with None."""
    ending: tuple[ExportFrame | None, ...] = (None,)
    for frame, following in pairwise(chain(frames, ending)):
        assert frame is not None
        yield frame, following


class _Resting:
    """The Gaussians that rest for a segment, or for `NEST` of them, or for as many of those, and change elsewhere.

    There is a group for each of these lengths that the take is longer than. A Gaussian is in that of the longest one
    in which it rests.
    """

    def __init__(self, census: Census) -> None:
        self._census = census
        self._present: dict[int, Ids] = {}
        length = SEGMENT
        while length < len(census.frames):
            self._present[length] = np.zeros(0, np.int64)
            length *= NEST

    def begin(self, number: int, frame: ExportFrame) -> Iterator[Rows]:
        """The groups that get other rows at the take's frame ``number``, the longest first."""
        alive = np.intersect1d(self._census.dynamic_ids, frame.ids)
        for length in sorted(self._present, reverse=True):
            if number % length:
                continue
            elsewhere = [ids for other, ids in self._present.items() if other > length]
            ids = np.setdiff1d(alive, np.concatenate([self._touched(number, length), *elsewhere]))
            if len(ids) == len(self._present[length]):
                # As many rows as before would be interpolated with them: one of them counts as resting less long.
                ids = ids[1:]
            self._present[length] = ids
            following = number + length
            until = just_before(self._census.frames[following]) if following < len(self._census.frames) else None
            name = RESTING_GROUP if length == SEGMENT else f"{RESTING_GROUP}{length}"
            yield _at_rest(name, frame, ids, self._census.newborn, until)

    def movers(self, number: int, frame: ExportFrame) -> Ids:
        """Who changes in the segment from frame ``number`` on, and whoever else is alive and in no group at rest."""
        at_rest = np.concatenate([np.zeros(0, np.int64), *self._present.values()])
        left = np.setdiff1d(np.intersect1d(self._census.dynamic_ids, frame.ids), at_rest)
        return np.union1d(self._touched(number, SEGMENT), left)

    def _touched(self, number: int, length: int) -> Ids:
        """Who changes in the ``length`` frames from ``number`` on, or in the step to the next one."""
        # The last frame, alone in a segment, has none after it.
        segments = self._census.touched[number // SEGMENT : (number + length) // SEGMENT]
        return np.unique(np.concatenate([np.zeros(0, np.int64), *segments]))


class _Moving:
    """The Gaussians of a segment that change in it, from frame to frame; those that are not alive keep their values."""

    def __init__(self, ids: Ids, newborn: Splats) -> None:
        self._ids, self._current = ids, newborn
        self._values, self._alive = usd_splats(newborn), np.zeros(len(ids), np.bool_)
        self._shown: ExportFrame | None = None

    def show(self, frame: ExportFrame) -> None:
        before, self._shown = self._shown, frame
        if before is None or frame.splats is not before.splats or frame.ids is not before.ids:
            self._alive, rows, slots = _rows_of(self._ids, frame.ids)
            self._current = _placed(self._current, take_splats(_cut(frame.splats, self._current), rows), slots)
            self._values = replace(usd_splats(self._current), velocities=self._values.velocities)

    def head_for(self, following: ExportFrame | None, fps: float) -> None:
        """Velocities from the frame shown to the next one; who is not in both has none. They last until told anew."""
        assert self._shown is not None
        velocities = np.zeros((len(self._ids), 3), np.float32)
        if following is not None:
            stays, rows, slots = _rows_of(self._ids, following.ids)
            moved = following.splats.means[rows].astype(np.float64) - self._current.means[slots]
            velocities[slots] = moved * (fps / (following.index - self._shown.index))
            velocities[~(stays & self._alive)] = 0
        self._values = replace(self._values, velocities=velocities)

    def rows(self, time: float) -> Rows:
        return Rows(DYNAMIC_GROUP, time, self._ids, self._values, self._alive)


def _at_rest(group: str, frame: ExportFrame, ids: Ids, newborn: Splats, until: float | None) -> Rows:
    """Who is alive throughout a segment and changes in another one only."""
    alive, rows, _ = _rows_of(ids, frame.ids)
    splats = usd_splats(take_splats(_cut(frame.splats, newborn), rows))
    return Rows(group, frame.index, ids, splats, alive, until)


def _at_ids(census: Census, ids: Ids) -> Splats:
    """The first values of some of those who ever change."""
    return take_splats(census.newborn, np.searchsorted(census.dynamic_ids, ids))


def _write_dynamic(usd: UsdWriter, census: Census, frames: Iterable[ExportFrame], fps: float | None) -> None:
    largest, present = int(census.dynamic_ids.max()), dict[str, Ids]()
    for rows in follow_dynamic(census, frames, fps):
        if rows.group not in present:
            usd.add_group(rows.group, rows.ids, largest_id=largest)
        elif rows.ids is not present[rows.group]:
            usd.regroup(rows.group, rows.ids)
        present[rows.group] = rows.ids
        usd.write_frame(rows.group, rows.time, rows.splats, rows.alive, until=rows.until)


def usd_splats(splats: Splats) -> UsdSplats:
    """Activated values of stored ones: scales, opacities, unit quaternions, linear view-independent colour; and SH."""
    colours = np.clip(0.5 + SH_C0 * splats.sh[:, 0], 0.0, 1.0).astype(np.float64)
    return UsdSplats(
        positions=splats.means,
        rotations=unit_rotations(splats),
        scales=np.exp(splats.log_scales),
        colours=linear_from_srgb(colours).astype(np.float32),
        opacities=sigmoid(splats.opacity_logits),
        sh=splats.sh,
    )


def _check_order(indices: list[int], index: int) -> None:
    if indices and index <= indices[-1]:
        raise ValueError(f"frame {index} follows frame {indices[-1]}; indices must rise")


def _cut(splats: Splats, like: Splats) -> Splats:
    """The splats with as much view dependence as ``like`` has; arrays are shared, not copied."""
    sh = splats.sh[:, : like.sh.shape[1]]
    return Splats(splats.means, splats.log_scales, splats.quaternions, splats.opacity_logits, sh)


def _sorted_by_id(frame: ExportFrame, *, view_dependent: bool) -> ExportFrame:
    """The same frame, ids rising; without view dependence, SH are cut to degree 0."""
    order = np.argsort(frame.ids, kind="stable")
    ids = frame.ids[order]
    if (ids[1:] == ids[:-1]).any():
        raise ValueError(f"frame {frame.index} has an id twice")
    splats = frame.splats if view_dependent else _cut(frame.splats, empty_splats(0))
    return ExportFrame(frame.index, ids, take_splats(splats, order))


def _touched(before: ExportFrame, after: ExportFrame) -> Ids:
    """Ids that changed any value, appeared or vanished between two frames that are sorted by id."""
    common, rows_before, rows_after = np.intersect1d(before.ids, after.ids, assume_unique=True, return_indices=True)
    differs = np.zeros(len(common), np.bool_)
    for name, old in vars(before.splats).items():
        new = getattr(after.splats, name)
        unequal = old[rows_before] != new[rows_after]
        differs |= unequal.any(axis=tuple(range(1, unequal.ndim)))
    return np.concatenate([common[differs], np.setxor1d(before.ids, after.ids, assume_unique=True)])


def _rows_of(ids: Ids, frame_ids: Ids) -> tuple[Mask, NDArray[np.intp], NDArray[np.intp]]:
    """Where sorted ``ids`` occur in a frame: which do, at which rows of the frame, and at which places of ``ids``."""
    order = np.argsort(frame_ids, kind="stable")
    sorted_index = np.minimum(np.searchsorted(frame_ids, ids, sorter=order), max(len(frame_ids) - 1, 0))
    if len(frame_ids) == 0:
        return np.zeros(len(ids), np.bool_), np.zeros(0, np.intp), np.zeros(0, np.intp)
    rows = order[sorted_index]
    alive = frame_ids[rows] == ids
    return alive, rows[alive], np.flatnonzero(alive)


def _placed(splats: Splats, new: Splats, slots: NDArray[np.intp]) -> Splats:
    """A copy of ``splats`` with ``new`` at ``slots``."""
    copies = {name: value.copy() for name, value in vars(splats).items()}
    for name, value in copies.items():
        value[slots] = getattr(new, name)
    return Splats(**copies)
