"""Pictures for training: planar floats of pinhole cameras; those of held-out cameras separately.

The held-out camera's pictures go into ``RigFrame.held_out`` only; nothing that trains or writes packets takes that
field.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.decoder.cameras.lens import Undistortion, with_k1
from decogs.decoder.subject.matte_checks import is_white
from decogs.formats.cameras import Camera, camera_centre, in_picture, project, rig_extent, scale_camera
from decogs.formats.colours.srgb import Colour, srgb_from_linear
from decogs.formats.errors import RigError, UsageError
from decogs.formats.frames.ranges import Frames, frame_slice
from decogs.formats.rigs import Rig, read_frames
from decogs.formats.splats import FloatArray

from ..mattes import Cut, Mattes
from .compositing import over
from .recorded_at import RecordedAt, recorded_at
from .recording_digests import digest_of

Picture = NDArray[np.uint8] | NDArray[np.float32]
PictureArray = TypeVar("PictureArray", bound=NDArray[Any])
Size = tuple[int, int]
"""Width and height in pixels."""

NEAR_FRACTION = 0.1
"""Near plane of a rig camera as a share of the median depth it sees: beyond any housing, before any subject."""


_MIN_TEACHING_SHARE = 0.999
"""Share of a pixel that an ignore mask leaves, from which it teaches: scaled and straightened, edges mix."""
_FLOAT32_ROUNDING = 2.0**-24
"""Of a float32 position, relative to its distance from the world's origin."""
_MAX_ROUNDING_PIXELS = 0.5
"""Largest shift of a position by its rounding, in a picture."""
_MIN_CAMERA_DISTANCE = 1e-6
"""World units between the outermost cameras. A lattice has no steps below 1e-12; a thousandth of this distance loses 4
dB."""


@dataclass(frozen=True)
class View:
    """What one camera contributes to training, at the scale trained at.

    ``camera`` is the rig's with its lens, ``pinhole`` what is rendered; ``valid`` (H, W) float32 is 1 where the
    undistorted picture was recorded and is not ignored, or None when that is everywhere.
    """

    camera: Camera
    pinhole: Camera
    valid: FloatArray | None

    @property
    def recorded(self) -> NDArray[np.bool_] | None:
        """The pixels (H, W) of ``valid``, or None when that is everywhere."""
        return None if self.valid is None else self.valid > 0

    @cached_property
    def recorded_at(self) -> RecordedAt:
        """Where its pixels were recorded: 8 bytes each through a bent lens, kept once asked for."""
        return recorded_at(self.camera, self.pinhole)

    @property
    def pixels(self) -> int:
        """How many were recorded."""
        return self.pinhole.width * self.pinhole.height if self.valid is None else int(np.count_nonzero(self.valid))


@dataclass(frozen=True)
class RigFrame:
    """One time index: pictures (3, H, W) float32 0..1 of the training views and of the held-out ones, in order.

    ``own_size``: the held-out ones (H, W, 3) at their cameras' own size and with their lenses; none without a scale.
    ``recorded``: digests by camera of the training pictures as they were decoded.
    ``alpha``: of each training view, (H, W) float32 0..1, how much of a pixel the subject covers; none without mattes.
    ``held_out_alpha``: the same of the held-out views, None for those without a matte. ``plates``: of each training
    view the backdrop alone, as a picture, where a clean one was given; else none. ``screen_coloured_shares``: of each
    training view the share of the subject that has the screen's colour; none without a key. ``lost``: why a
    camera, by name, has no picture of this frame, or none that can be cut out; what stands in its place shows nothing.
    """

    index: int
    training: list[FloatArray]
    held_out: list[FloatArray]
    own_size: Sequence[Picture] = ()
    alpha: Sequence[FloatArray] = ()
    recorded: Mapping[str, str] = field(default_factory=dict)
    held_out_alpha: Sequence[FloatArray | None] = ()
    plates: Sequence[FloatArray] = ()
    screen_coloured_shares: Sequence[float] = ()
    lost: Mapping[str, str] = field(default_factory=dict)

    def lost_views(self, views: Sequence[View]) -> dict[int, str]:
        """Why views, by number, have no picture of this frame."""
        names = [view.camera.name for view in views]
        return {names.index(name): why for name, why in self.lost.items() if name in names}


class Ingest:
    """A rig seen through its training and held-out views at one scale.

    ``lens``: by camera, a k1 (OpenCV) that its calibration does not know. ``mattes``: of the subject, and what no
    picture teaches. With a ``background``, pictures are the subject over that colour. Raises UsageError when a held-out
    name, or one in ``lens``, is no camera, when no camera is left to train on, or for an impossible scale; RigError for
    cameras
    so far from the world's origin that 32-bit positions blur what they see, or too close together in the world's unit.
    """

    def __init__(
        self,
        rig: Rig,
        *,
        holdout: Sequence[str] = (),
        scale: float = 1.0,
        lens: Mapping[str, float] | None = None,
        mattes: Mattes | None = None,
        background: Colour | None = None,
    ) -> None:
        is_number = isinstance(scale, (int, float, np.floating))
        if not (is_number and 0 < scale <= 4):
            given = f"{scale:g}" if is_number else repr(scale)
            raise UsageError(f"`scale` {given}: give a number above 0 and at most 4, such as 0.5")
        names = [camera.name for camera in rig.cameras]
        check_held_out(rig, holdout)
        rig = _with_lenses(rig, lens) if lens else rig
        self.rig = rig
        self.scale = scale
        self._names = [name for name in names if name not in holdout]
        self._held_names = [name for name in names if name in holdout]
        if not self._names:
            raise UsageError(f"{rig.path}: every camera is held out; leave at least one to train on")
        cameras = {camera.name: scale_camera(camera, scale) for camera in rig.cameras}
        _check_near_origin(rig, [cameras[name] for name in names])
        self._plans = {name: Undistortion(cameras[name]) for name in names}
        self._near = dict.fromkeys(names, 0.0)
        self._mattes = Mattes() if mattes is None else mattes
        self._valid = {name: self._teaching(name) for name in names}
        self._fillings = {name: _filling(valid) for name, valid in self._valid.items()}
        self._plates = [self._prepare(name, self._mattes.plates[name]) for name in self._names if self._mattes.plates]
        self.background = background
        self.views = [self._view(name) for name in self._names]
        self.held_out_views = [self._view(name) for name in self._held_names]

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """All cameras of the rig in its order and at their own size, so that decoded views lie over the videos."""
        return tuple(replace(camera, near=self._near[camera.name]) for camera in self.rig.cameras)

    @property
    def rate(self) -> float | None:
        """Frames in a second as they were recorded, whatever a stream plays; None where unknown."""
        rate = self.rig.timeline.rate
        return None if rate is None else float(rate)

    @property
    def has_mattes(self) -> bool:
        """Whether frames come with alpha."""
        return self._mattes.cuts

    @property
    def matte_warnings(self) -> tuple[str, ...]:
        """What the user should know of the mattes' files, a line each."""
        return () if self._mattes.rig is None else self._mattes.rig.warnings

    def matte_origin(self, name: str, frame: int) -> str:
        """Where the matte of a camera and frame comes from, for a message."""
        return self._mattes.origin(name, frame)

    @property
    def held_out_sizes(self) -> dict[str, tuple[Size, Size]]:
        """Of every held-out camera: the size at which it is compared with the scene, and its own, in pixels."""
        own = {camera.name: (camera.width, camera.height) for camera in self.rig.cameras}
        return {v.camera.name: ((v.camera.width, v.camera.height), own[v.camera.name]) for v in self.held_out_views}

    def place_near_planes(self, xyz: FloatArray) -> None:
        """Gives every camera a near plane at NEAR_FRACTION of the median depth of the points (P, 3) it sees.

        Geometry only, found by the training views: a held-out camera's pictures play no part.
        """
        self.set_near_planes(
            {name: NEAR_FRACTION * _median_depth(plan.pinhole, xyz) for name, plan in self._plans.items()}
        )

    def set_near_planes(self, near: Mapping[str, float]) -> None:
        """Gives every camera, by name, this near plane in world units."""
        self._near = dict(near)
        self.views = [self._view(name) for name in self._names]
        self.held_out_views = [self._view(name) for name in self._held_names]

    def frames(self, start: int, stop: int, *, first: int | None = None) -> Iterator[RigFrame]:
        """The rig's frames [start, stop) in order, one at a time.

        ``first``: the take's first frame, if that is not ``start``. Raises RigError for what is wrong in that one; in
        later ones such a view is ``lost``, as a held-out one that cannot be cut out is in any frame.
        """
        names, count = [*self._names, *self._held_names], len(self._names)
        first = start if first is None else first
        lost: dict[str, str] = {}

        def lose(index: int, name: str, error: RigError) -> None:
            if index == first:
                raise error
            lost.setdefault(name, str(error))

        def cut_out(name: str, picture: Picture, matte: FloatArray | None) -> Cut:
            if name not in lost:
                try:
                    cut = self._mattes.cut(name, picture, matte)
                    # Of the first frame `check_mattes` says it.
                    if index != first and cut.alpha is not None and is_white(cut.alpha):
                        raise RigError(f"camera {name}: its matte is white all over; white is subject, black is empty")
                    return cut
                except RigError as error:
                    if name in self._held_names:
                        lost[name] = str(error)
                    else:
                        lose(index, name, error)
            return Cut(picture, np.zeros(picture.shape[:2], np.float32) if self.has_mattes else None)

        shown = read_frames(self.rig, start, stop, names=names, on_lost=lose)
        given = self._mattes.given(names, start, stop, lose)
        # Not strict: a recording may end before.
        for (index, pictures), mattes in zip(shown, given, strict=False):
            recorded = self._digests(pictures, mattes)
            cut = [cut_out(name, picture, mattes.get(name)) for name, picture in zip(names, pictures, strict=True)]
            planes = [self._prepare(name, each.picture) for name, each in zip(names, cut, strict=True)]
            alphas = [self._alpha(name, each) for name, each in zip(names, cut, strict=True)]
            held_out = zip(self._held_names, pictures[count:], strict=True)
            own_size = [self._at_own_size(*each) for each in held_out] if self.scale != 1 else []
            frame = RigFrame(
                index,
                planes[:count],
                planes[count:],
                own_size,
                [alpha for alpha in alphas[:count] if alpha is not None],
                recorded,
                alphas[count:] if self._mattes.cuts else (),
                self._plates,
                [] if self._mattes.key is None else [each.screen_coloured_share for each in cut[:count]],
                dict(lost),
            )
            lost.clear()
            yield frame if self.background is None else _composited(frame, self.background)

    def _digests(self, pictures: Sequence[Picture], mattes: Mapping[str, FloatArray]) -> dict[str, str]:
        """Of each training camera's picture, and of what cuts its subject out."""
        shown = zip(self._names, pictures, strict=False)
        return {
            name: "".join(map(digest_of, [picture, *self._mattes.digest_inputs(name, mattes.get(name))]))
            for name, picture in shown
        }

    def _at_own_size(self, name: str, picture: Picture) -> Picture:
        camera = next(camera for camera in self.rig.cameras if camera.name == name)
        return _resized(picture, (camera.width, camera.height))

    def _view(self, name: str) -> View:
        plan = self._plans[name]
        valid = None if self._valid[name].all() else np.ascontiguousarray(self._valid[name], np.float32)
        near = self._near[name]
        return View(replace(plan.camera, near=near), replace(plan.pinhole, near=near), valid)

    def _prepare(self, name: str, picture: Picture) -> FloatArray:
        planes = np.ascontiguousarray(display_referred(self._undistorted(name, picture)).transpose(2, 0, 1))
        return self._filled(name, planes)

    def _alpha(self, name: str, cut: Cut) -> FloatArray | None:
        if cut.alpha is None:
            return None
        planes = np.clip(self._undistorted(name, cut.alpha), 0, 1)[None]  # cubic interpolation overshoots
        return np.asarray(self._filled(name, planes)[0])

    def _undistorted(self, name: str, picture: PictureArray) -> PictureArray:
        plan = self._plans[name]
        return plan.apply(_resized(picture, (plan.camera.width, plan.camera.height)))

    def _filled(self, name: str, planes: FloatArray) -> FloatArray:
        """The planes (C, H, W), as nearby where they do not teach."""
        missing, nearest = self._fillings[name]
        flat = planes.reshape(len(planes), -1)
        flat[:, missing] = flat[:, nearest]
        return planes

    def _teaching(self, name: str) -> NDArray[np.bool_]:
        """Pixels (H, W) of the training picture that were recorded and are not ignored."""
        valid, kept = self._plans[name].valid, self._mattes.kept.get(name)
        if kept is None:
            return valid
        return valid & (self._undistorted(name, kept.astype(np.float32)) > _MIN_TEACHING_SHARE)


def _resized(picture: PictureArray, size: Size) -> PictureArray:
    if picture.shape[1::-1] == size:
        return picture
    shrinks = size[0] < picture.shape[1]
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC)  # type: ignore[return-value]


def _composited(frame: RigFrame, background: Colour) -> RigFrame:
    """The frame's subject over ``background``; held-out pictures without a matte stay, and cannot be compared."""
    plates: Sequence[FloatArray | None] = frame.plates or [None] * len(frame.training)
    each = zip(frame.training, frame.alpha, plates, strict=True)
    held_out = [
        picture if alpha is None else over(picture, alpha, background)
        for picture, alpha in zip(frame.held_out, frame.held_out_alpha, strict=True)
    ]
    training = [over(picture, alpha, background, plate) for picture, alpha, plate in each]
    return replace(frame, training=training, held_out=held_out, own_size=())


def scene_extent(views: Sequence[View]) -> float:
    """Size of the views' rig; 3DGS scales position rates by it."""
    return rig_extent([view.pinhole for view in views])


def check_held_out(rig: Rig, holdout: Sequence[str]) -> None:
    """Raises UsageError when a name of ``holdout`` is no camera of the rig."""
    names = [camera.name for camera in rig.cameras]
    if isinstance(holdout, str) or not isinstance(holdout, Collection):
        raise UsageError(f"`holdout` {holdout}: give a list of names, such as ['{holdout}']")
    for name in holdout:
        if name not in names:
            raise UsageError(f"`holdout` {name}: {rig.path} has no such camera; it has {', '.join(names)}")


def frame_span(rig: Rig, frames: Frames) -> range:
    """The rig's frames that ``frames`` names, as Python would; raises UsageError when there are none or they skip."""
    chosen = range(rig.frame_count)[frame_slice(frames)]
    if not len(chosen):
        raise UsageError(f"`frames`: {rig.path} has frames 0 to {rig.frame_count - 1}; the range holds none of them")
    if chosen.step != 1:
        raise UsageError("`frames`: give consecutive frames, without a step")
    return chosen


def _with_lenses(rig: Rig, lens: Mapping[str, float]) -> Rig:
    """The rig with the k1 found for its lenses in their distortion models."""
    unknown = sorted(set(lens) - {camera.name for camera in rig.cameras})
    if unknown:
        raise UsageError(f"{rig.path}: there is no camera {unknown[0]}, so its lens cannot be corrected")
    cameras = (with_k1(camera, lens[camera.name]) if camera.name in lens else camera for camera in rig.cameras)
    return replace(rig, cameras=tuple(cameras))


def _check_near_origin(rig: Rig, cameras: Sequence[Camera]) -> None:
    """Raises RigError when rounding a position shifts it visibly, seen from as far as the cameras' distances."""
    centres = np.array([camera_centre(camera) for camera in cameras])
    far, size = np.linalg.norm(centres, axis=1).max(), np.linalg.norm(np.ptp(centres, axis=0))
    if 0 < size < _MIN_CAMERA_DISTANCE:
        raise RigError(
            f"{rig.path}: the cameras are only {size:.3g} units apart, too little for the quantisation of positions; "
            "scale the calibration up, for instance to metres"
        )
    pixels = far * _FLOAT32_ROUNDING * max(max(camera.fx, camera.fy) for camera in cameras)
    if size > 0 and pixels > _MAX_ROUNDING_PIXELS * size:
        raise RigError(
            f"{rig.path}: the cameras are {far:.3g} units from the world's origin and {size:.3g} apart, so 32-bit "
            f"positions would be off by {pixels / size:.1f} pixels; move the calibration's origin to the rig"
        )


def _filling(valid: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Flat indices of the pixels that were not recorded, and of the recorded one nearest to each.

    No loss counts them, but the search for first points would take black corners for a surface that every camera sees.
    """
    missing = np.flatnonzero(~valid)
    if not len(missing) or len(missing) == valid.size:
        return missing[:0], missing[:0]
    _, labels = cv2.distanceTransformWithLabels(
        (~valid).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    recorded = np.flatnonzero(valid)
    of_label = np.zeros(int(labels.max()) + 1, np.int64)
    of_label[labels.ravel()[recorded]] = recorded
    return missing, of_label[labels.ravel()[missing]]


def _median_depth(camera: Camera, xyz: FloatArray) -> float:
    """Median depth of the points inside the camera's picture; 0 when it sees none."""
    u, v, depth = project(camera, xyz)
    seen = in_picture(camera, u, v, depth)
    return float(np.median(depth[seen])) if seen.any() else 0.0


def display_referred(picture: Picture) -> FloatArray:
    """(H, W, 3) in 0..1: 8-bit pictures as they are, scene-linear ones clipped and sRGB-coded."""
    if picture.dtype == np.uint8:
        return np.asarray(picture.astype(np.float32) / np.float32(255))
    linear = np.clip(picture.astype(np.float32), 0, 1)
    return srgb_from_linear(linear)
