"""Files of Gaussians as a stream: what ``decogs-pack`` does.

There are no pictures: nothing is trained, and the lattice alone sets rate and quality. The loop is closed as in an
encode: every frame is compared with what a decoder has of the frame before. A stream's header needs a camera, and
files have none: those of a rig, or one that is made up, named "overview", that sees the first frame's Gaussians.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.reconstruct import reconstruct
from decogs.codec.scene.lattice import Lattice, Vector, default_lattice, quantise, robust_extent
from decogs.codec.scene.morton import morton_order
from decogs.codec.scene.state import DEFAULT_MAX_GAUSSIANS
from decogs.decoder.limits import DEFAULT_MAX_MEMORY
from decogs.formats.cameras import Camera, is_distorted
from decogs.formats.errors import StreamError, TrainingError, UsageError
from decogs.formats.files.outputs import STREAM, Output, check_outputs
from decogs.formats.rigs import Rig
from decogs.formats.splat_files import Room
from decogs.formats.splats import FloatArray, Splats, take_splats
from decogs.formats.stream.container import MAX_FRAME, Packet
from decogs.formats.system.callbacks import OnProgress, OnWarning
from decogs.rig.pictures.ingest import check_held_out

from ..coding.packets import frame_packet, key_packet
from ..coding.scene import Scene
from ..input.row_matching import Rows, mutual_nearest
from ..output.stream_output import StreamOutput, open_output
from ..settings.frame import SignificanceSettings
from ..training.method import TrainedFrame
from .inputs import InputFrame, PackInput, pack_input

_NEUTRAL_QUALITY, _QUALITIES_PER_DOUBLING, _NEUTRAL_SCALE = 50.0, 25.0, 0.5
_HYSTERESIS_STEPS = 0.75
"""Lattice steps from a value's integer within which the integer stays: noise between frames is not coded."""
_MAX_JUMP_FRACTION = 0.05
"""Median way of a row between two frames, as a share of the scene, beyond which rows are in no common order."""
_FLOAT_COPIES = 12
"""Of its floats that a Gaussian takes: 11 were measured of two frames that are matched by position (SH degree 3)."""
_CAMERA_WIDTH, _CAMERA_HEIGHT, _FOCAL_PIXELS = 1280, 720, 1100.0
_PACKED_SETTING = "packed"
"""The setting that marks a packed stream; without it, it is of an encode that could be resumed."""


@dataclass(frozen=True)
class PackReport:
    """Bytes of the frames' packets, of the stream, and of the files; how many frames were matched by position."""

    frame_bytes: tuple[int, ...]
    total_bytes: int
    read_bytes: int
    matched_by_position: int


def pack(
    files: str | os.PathLike[str],
    output: str | os.PathLike[str] | BinaryIO,
    *,
    fps: float | None = None,
    rig: Rig | None = None,
    holdout: Sequence[str] = (),
    quality: float = _NEUTRAL_QUALITY,
    lossless: bool = False,
    segment: int = 0,
    max_memory: int = DEFAULT_MAX_MEMORY,
    on_frame: OnProgress | None = None,
    on_warning: OnWarning | None = None,
) -> PackReport:
    """Codes .ply or .spz files, one a frame, or a .4dgs or .splat4d as a .dgs stream.

    ``files``: their name, with a place for the frame's number (`decogs.formats.frames.names`), or that of a .4dgs or
    .splat4d. Gaussians of one id are the same Gaussian. Without ids, rows of files with the same number of Gaussians
    are, unless they jump about; else they are matched by position. ``fps``: of the stream; a .4dgs is sampled at it,
    and None is a file's own. ``rig``: whose cameras the stream gets, in the same world; ``holdout``: those of them
    that the files' training did not see.
    ``quality``: 0 to 100, of the lattice: 25 less double its steps. ``lossless``: every change is coded, exact to the
    lattice of quality 100. ``segment``: frames from one keyframe to the next, 0 for a single one. One frame is in
    memory at a time, in ``max_memory`` bytes beyond the program itself; ``on_frame(done, all)``. Raises UsageError for
    files that cannot be read or do not fit each other; nothing is then left under the output's name.
    """
    scale = _checked_scale(quality, fps, segment, lossless=lossless)
    if holdout and rig is None:
        raise UsageError("`holdout`: goes with `rig`, whose cameras it names")
    if rig is not None:
        check_held_out(rig, holdout)
    room, sizes = Room(DEFAULT_MAX_GAUSSIANS, max_memory, _FLOAT_COPIES), list[int]()
    given = pack_input(Path(files), fps, room, on_warning or (lambda text: None))
    if given.count > MAX_FRAME:
        raise UsageError(f"{files}: a stream holds {MAX_FRAME} frames, and there are {given.count}; give fewer")
    target = Path(output) if isinstance(output, (str, os.PathLike)) else output
    check_outputs([Output("output", target, grows=True, format=STREAM)], [(path, "is read") for path in given.paths])
    with open_output(target, resumable=False, expendable=lambda left, _: _PACKED_SETTING in left.settings) as stream:
        try:
            packing = None
            for frame in given.frames():
                if packing is None:
                    packing = _Packing(_header(given, frame, scale, rig, holdout), stream, segment, exact=lossless)
                sizes.append(packing.add(frame))
                if on_frame is not None:
                    on_frame(len(sizes), given.count)
        except BaseException:
            stream.close(0)
            raise
        stream.close(len(sizes))
        total = stream.publish()
    by_position = 0 if packing is None else packing.by_position
    return PackReport(tuple(sizes), total, sum(path.stat().st_size for path in given.paths), by_position)


class _Packing:
    """The stream so far; ``_rows``: the row in the last frame of each Gaussian of the state, and ``_ids`` theirs."""

    def __init__(self, header: StreamHeader, output: StreamOutput, segment: int, *, exact: bool) -> None:
        self._header, self._output, self._segment, self._exact = header, output, segment, exact
        self._scene: Scene | None = None
        self._rows: Rows = np.zeros(0, np.int64)
        self._ids: Rows | None = None
        self._frames = 0
        self.by_position = 0

    def add(self, frame: InputFrame) -> int:
        """Codes the next frame; bytes of its packet."""
        try:
            packet = self._first(frame.splats) if self._scene is None else self._next(self._scene, frame)
        except TrainingError as error:
            raise UsageError(f"{frame.name}: {error}") from None
        if self._scene is None:
            self._scene = Scene.open(self._header, reconstruct(None, packet, self._header))
        else:
            self._scene = self._scene.after(self._scene.read(packet))
        self._ids = None if frame.ids is None else frame.ids[self._rows]
        self._output.write(packet.kind, packet.frame, packet.payload)
        self._frames += 1
        return packet.size

    def _first(self, splats: Splats) -> Packet:
        state, self._rows = keyframe_state(quantise(splats, self._header.lattice))
        self._output.begin(self._header.to_bytes())
        return key_packet(self._header, state, {}).packet

    def _next(self, scene: Scene, frame: InputFrame) -> Packet:
        header, splats = self._header, frame.splats
        if splats.sh_degree != header.sh_degree:
            raise UsageError(
                f"{frame.name}: has SH degree {splats.sh_degree}, the first file has {header.sh_degree}; "
                "export all alike"
            )
        kept, rows = self._match(scene.splats.means, frame)
        removed = np.setdiff1d(np.arange(len(scene.splats)), kept)
        added = np.setdiff1d(np.arange(len(splats)), rows)
        values = take_splats(splats, rows)
        if not self._exact:
            values = _with_hysteresis(take_splats(scene.splats, kept), values, header.lattice)
        trained = TrainedFrame(kept, values, removed, take_splats(splats, added))
        # The stream has new Gaussians in Morton order, behind the others.
        added = added[morton_order(quantise(trained.added, header.lattice).means)]
        self._rows = np.concatenate([rows, added])
        return frame_packet(scene, self._frames, trained, SignificanceSettings(), {}, segment=self._segment).packet

    def _match(self, before: FloatArray, frame: InputFrame) -> tuple[Rows, Rows]:
        """Rows of the state, whose positions were ``before``, that go on, ascending, and their rows in the frame."""
        means = frame.splats.means
        if self._ids is not None and frame.ids is not None:
            _, kept, rows = np.intersect1d(self._ids, frame.ids, assume_unique=True, return_indices=True)
            order = np.argsort(kept)
            return kept[order], rows[order]
        if len(means) == len(before):
            way = np.linalg.norm(means[self._rows].astype(np.float64) - before, axis=1)
            if np.median(way) <= _MAX_JUMP_FRACTION * robust_extent(before)[0]:
                return np.arange(len(before)), self._rows
        self.by_position += 1
        reach = max(robust_extent(before)[0], 1e-12) / np.sqrt(len(before))
        return mutual_nearest(before, means, float(reach))


def _with_hysteresis(before: Splats, now: Splats, lattice: Lattice) -> Splats:
    """``now``, with the decoder's values where they are within the hysteresis; rotations as they are."""

    def steady(was: NDArray[np.float32], values: NDArray[np.float32], step: object) -> NDArray[np.float32]:
        near = np.abs(values.astype(np.float64) - was) <= _HYSTERESIS_STEPS * np.asarray(step, np.float64)
        return np.where(near, was, values)

    sh_steps = np.full((before.sh.shape[1], 1), lattice.sh_rest)
    sh_steps[0] = lattice.sh_dc
    return replace(
        now,
        means=steady(before.means, now.means, lattice.means),
        log_scales=steady(before.log_scales, now.log_scales, lattice.log_scales),
        opacity_logits=steady(before.opacity_logits, now.opacity_logits, lattice.opacity_logits),
        sh=steady(before.sh, now.sh, sh_steps),
    )


def _checked_scale(quality: float, fps: float | None, segment: int, *, lossless: bool) -> float:
    """How coarse the lattice is; raises UsageError for what cannot be."""
    if not 0 <= quality <= 100:
        raise UsageError(f"`quality` {quality:g}: give a number from 0 (smallest) to 100 (most exact)")
    if fps is not None and not 1e-6 <= fps <= 1e6:
        raise UsageError(f"`fps` {fps:g}: give a positive number of frames per second")
    if not 0 <= segment <= MAX_FRAME:
        raise UsageError(f"`segment` {segment}: give a number of frames, or 0 for a single keyframe")
    return float(
        _NEUTRAL_SCALE * 2 ** ((_NEUTRAL_QUALITY - (100.0 if lossless else quality)) / _QUALITIES_PER_DOUBLING)
    )


def _header(given: PackInput, frame: InputFrame, scale: float, rig: Rig | None, holdout: Sequence[str]) -> StreamHeader:
    if not len(frame.splats):
        raise UsageError(f"{frame.name}: has no Gaussian, and a stream begins with some")
    extent, centre = robust_extent(frame.splats.means)
    if not extent > 0:
        raise UsageError(f"{frame.name}: all its Gaussians are in one place; export it again")
    cameras = (_overview(extent, centre, given.up),) if rig is None else rig.cameras
    effects = ["motion", "appearance_change", "emergence", "disappearance"]
    effects += ["view_dependence"] if frame.splats.sh_degree else []
    effects += ["lens_distortion"] if any(is_distorted(camera) for camera in cameras) else []
    header = StreamHeader(
        cameras=cameras,
        lattice=default_lattice(extent, centre=centre, scale=scale),
        sh_degree=frame.splats.sh_degree,
        fps=given.fps if given.fps or rig is None else rig.fps,
        first_frame=min(given.first, MAX_FRAME),
        effects=tuple(effects),
        held_out=tuple(holdout),
        units=(rig and rig.length_unit) or "world units of the files",
        settings={"lattice_scale": scale, _PACKED_SETTING: given.paths[0].name},
    )
    try:
        header.to_bytes()
    except StreamError:
        raise UsageError(
            f"{frame.name}: a stream cannot hold a scene of {extent:.3g} units; scale it to metres"
        ) from None
    return header


def _overview(extent: float, centre: Vector, up: Literal["Y", "-Y"]) -> Camera:
    """A camera before the scene, upright as files of this format are, from which its extent fills the picture."""
    pose = np.diag([1.0, 1.0, 1.0, 1.0] if up == "-Y" else [1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = -pose[:3, :3] @ np.asarray(centre)
    pose[2, 3] += extent * (0.5 + _FOCAL_PIXELS / _CAMERA_HEIGHT)
    return Camera(
        "overview",
        _CAMERA_WIDTH,
        _CAMERA_HEIGHT,
        _FOCAL_PIXELS,
        _FOCAL_PIXELS,
        _CAMERA_WIDTH / 2,
        _CAMERA_HEIGHT / 2,
        pose,
    )
