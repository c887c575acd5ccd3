"""The first frame, or the first one of another scene: from its pictures to the keyframe's Gaussians."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.corrections import Corrections
from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.scene.lattice import Lattice, dequantise, quantise
from decogs.codec.scene.state import State
from decogs.formats.errors import RigError
from decogs.formats.splats import FloatArray
from decogs.rig.pictures.dropouts import BLACK, blankness
from decogs.rig.pictures.ingest import Ingest, RigFrame, View
from decogs.rig.stage.open_air import find_open_air, open_air_of
from decogs.rig.stage.stage import PlainStage, Stage, find_stage

from ..backends import TrainingKernel
from ..input.compensation import Corrector
from ..input.compensation.frame import find_camera_colours, match_colours
from ..output.reports import OnKeyframeStep
from ..settings.encode import EncodeSettings
from ..stopwatch import Stopwatch
from ..training.schedule import StoppingRule
from .first_points import FirstPoints, first_points, take_points
from .first_points.missed import with_missed
from .harmonics import trim_sh_degree
from .large_pictures import fit_to_pictures
from .train import prealigned_pictures, train_keyframe


@dataclass(frozen=True)
class FirstFrame:
    """A scene's first frame: its Gaussians on their ``lattice``, and how its cameras' ``colours`` differ, for good.

    ``recorded``: its pictures without these differences, and the ``stage`` in them, if they show one.
    """

    state: State
    lattice: Lattice
    colours: Corrections
    recorded: RigFrame
    stage: Stage | None


def train_first_frame(
    kernel: TrainingKernel,
    ingest: Ingest,
    frame: RigFrame,
    settings: EncodeSettings,
    watch: Stopwatch,
    *,
    seed: int,
    threads: int,
    corrector: Corrector | None,
    stopping: StoppingRule,
    on_step: OnKeyframeStep | None,
    header: StreamHeader | None = None,
    first_id: int = 0,
) -> FirstFrame:
    """The keyframe's Gaussians; sets the ingest's near planes.

    ``corrector``: of the cameras whose drift is compensated. ``header``: of a stream that goes on with another scene.
    Near planes, colours, lattice and degree of SH are then those that it has, and the frame's colours are matched
    already. ``first_id``: of the Gaussians.

    If a camera shakes, a short training finds its pose, and the search for first points runs again. With detection per
    frame, view dependence is detected here. Raises RigError for a black picture and TrainingError for failed training.
    """
    if header is None:
        _check_not_black(frame, ingest.views)

    most = fit_to_pictures([view.pixels for view in ingest.views], settings.keyframe).first_points

    def points_of(frame: RigFrame) -> tuple[FirstPoints, Stage | None]:
        stage = find_stage(ingest.views, frame)
        points = first_points(
            [view.pinhole for view in ingest.views],
            [picture.transpose(1, 2, 0) for picture in frame.training],
            recorded=[view.recorded for view in ingest.views],
            given=ingest.rig.points,
            cap=most if stage is None else max(1, round(stage.hull.share * most)),
            within=None if stage is None else stage.may_show,
            seed=seed,
            threads=threads,
        )
        if header is None:
            ingest.place_near_planes(points.xyz)
        return points, stage

    def fitted(points: FirstPoints, stage: Stage | None, frame: RigFrame) -> tuple[FirstPoints, Stage | None]:
        """Without points before a sky, and with those that the sweep misses on a stage."""
        if stage is not None:
            room = max(1, round(stage.hull.share * most))
            return with_missed(points, stage, ingest.views, frame.training, most=room, threads=threads), stage
        air = find_open_air(ingest.views, frame, points.xyz)
        return (points, stage) if air is None else (take_points(points, air.may_show(points.xyz)), air)

    keyframe = settings.keyframe if header is None else replace(settings.keyframe, sh_degree=header.sh_degree)
    colours: Corrections = {} if header is None else header.camera_colours
    with watch.stage("first_points"):
        points, stage = points_of(frame)
        frame_stage = stage
        if header is None and settings.corrections.are_constant:
            shared = stage.shared_points() if isinstance(stage, PlainStage) else (points.xyz, points.seen)
            colours = find_camera_colours(frame, ingest.rate, ingest.views, settings.corrections, *shared)
        if header is None and colours:
            frame = match_colours(frame, ingest.views, colours)
            frame_stage = find_stage(ingest.views, frame)
            stage = None if stage is None else frame_stage
        points, stage = fitted(points, stage, frame)
    if corrector is not None and corrector.cameras.camera_shake:
        with watch.stage("pre-alignment"):
            prealigned = prealigned_pictures(
                kernel, ingest.views, frame.training, points, keyframe, corrector, seed=seed
            )
            aligned = replace(frame, training=prealigned)
            points, stage = fitted(*points_of(aligned), aligned)
    with watch.stage("keyframe"):
        trained = train_keyframe(
            kernel,
            ingest.views,
            frame.training,
            points,
            keyframe,
            seed=seed,
            lattice=None if header is None else header.lattice,
            lattice_scale=settings.lattice_scale,
            corrector=corrector,
            on_step=on_step,
            stopping=stopping,
            stage=stage,
            alphas=frame.alpha,
        )
    values = quantise(trained.splats, trained.lattice)
    if settings.detect_per_frame and header is None:
        values = trim_sh_degree(values)
    state, _ = keyframe_state(values, first_id=first_id)
    if frame_stage is None:
        frame_stage = open_air_of(ingest.views, frame, dequantise(values, trained.lattice).means)
    return FirstFrame(state, trained.lattice, colours, frame, frame_stage)


def stage_of_keyframe(views: Sequence[View], frame: RigFrame, means: FloatArray) -> Stage | None:
    """The stage in the first ``frame`` of a keyframe that is there already, with Gaussians at ``means`` (N, 3)."""
    return find_stage(views, frame) or open_air_of(views, frame, means)


def _check_not_black(frame: RigFrame, views: Sequence[View]) -> None:
    """Raises RigError for a black training picture, which would make the keyframe fog."""
    for view, picture in zip(views, frame.training, strict=True):
        if blankness(picture) == BLACK:
            name = view.camera.name
            raise RigError(
                f"camera {name} is black in frame {frame.index}; a keyframe needs every camera: start at a "
                f"later frame (`frames`) or leave the camera out (`exclude` {name})"
            )
