"""The pictures of a film, one by one: which frame each shows, from where, and what compositing needs beside it."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.corrections import Correction
from decogs.formats.cameras import Camera
from decogs.formats.colours.srgb import Colour
from decogs.formats.splats import FloatArray

from ..cameras.corrections import with_recorded_colours
from ..cameras.lens import Redistortion
from ..cameras.path import CameraPath, camera_of_frame
from ..limits import check_picture
from ..output.exr import Layers
from ..reading.frame import DecodedFrame
from .compositing import Ids, dynamic_part, motion_to
from .layouts import Layout
from .unseen import Sight
from .views import (
    behind_subject,
    camera_of,
    correction_of,
    max_pairs,
    recorded_colour,
    render_view,
    scaled_view,
    standing_camera,
    view_plan,
)

if TYPE_CHECKING:
    from ..rasterise import Rendering


@dataclass(frozen=True)
class Show:
    """How pictures are rendered, whatever they show; as in ``render_view``.

    ``cut_out``: over black, for an output that keeps the alpha. ``shows_unseen``: what no camera saw is drawn, too.
    """

    scale: float
    background: Colour | None
    undistorted: bool
    threads: int
    drift_free: bool
    max_memory: int
    layout: Layout | None = None
    cut_out: bool = False
    shows_unseen: bool = True

    @property
    def of_view(self) -> dict[str, Any]:
        """What ``render_view`` and ``PlayedView`` both take."""
        others = ("drift_free", "layout", "cut_out", "shows_unseen")
        return {name: value for name, value in vars(self).items() if name not in others}

    def over(self, header: StreamHeader) -> Colour:
        """The display-referred colour behind the stream's scene."""
        return header.background if self.background is None else self.background

    def as_cut_out(self, header: StreamHeader) -> Show:
        """The same pictures over nothing: of a subject over black, of a whole scene as they are."""
        return replace(self, background=(0.0, 0.0, 0.0) if header.subject else self.over(header), cut_out=True)


@dataclass(frozen=True)
class Shot:
    """One picture to be taken: its number in the output, the frame it shows, and the view it shows it from.

    ``is_asked_for`` is False for one that is only there for its neighbour's motion vectors.
    """

    number: int
    frame: DecodedFrame
    view: str | Camera
    is_asked_for: bool = True


def shots_by_frame(frames: Iterator[DecodedFrame], wanted: str | CameraPath) -> Iterator[Shot]:
    """One picture of every frame, which gives it its number."""
    for frame in frames:
        if isinstance(wanted, CameraPath) and len(wanted.cameras) > 1:
            yield Shot(frame.index, frame, camera_of_frame(wanted.cameras, frame.index))
        else:
            yield Shot(frame.index, frame, first_view(wanted))


def asked_for(shots: Iterator[Shot], chosen: range) -> Iterator[Shot]:
    """The same shots, those outside ``chosen`` marked as neighbours."""
    return (replace(shot, is_asked_for=shot.number in chosen) for shot in shots)


def first_view(wanted: str | CameraPath) -> str | Camera:
    """The rig camera, or a path's first camera: all pictures have its size."""
    return wanted if isinstance(wanted, str) else wanted.cameras[0]


def pictures(
    header: StreamHeader, shots: Iterator[Shot], wanted: str | CameraPath, show: Show
) -> Iterator[tuple[Shot, Rendering]]:
    """Shot by shot what the camera sees; of a fixed camera's picture, only what changed is rendered again."""
    drawn = _drawn(header, shots, wanted, show)
    if show.shows_unseen:
        yield from drawn
        return
    sight = Sight(header, show.threads, show.max_memory)
    for shot, picture in drawn:
        plan = _plan(header, shot, show)
        yield shot, sight.left_out(shot.frame.splats, plan, picture, None if show.cut_out else show.over(header))


def _drawn(
    header: StreamHeader, shots: Iterator[Shot], wanted: str | CameraPath, show: Show
) -> Iterator[tuple[Shot, Rendering]]:
    from .played_view import PlayedView

    if show.layout is not None:
        yield from ((shot, _laid_out(header, shot, show, show.layout)) for shot in shots)
        return
    is_fixed = isinstance(wanted, str) or len(wanted.cameras) == 1
    fixed = PlayedView(header, first_view(wanted), **show.of_view, drift_free=show.drift_free) if is_fixed else None
    for shot in shots:
        if fixed is not None:
            yield shot, fixed.show(shot.frame)
        else:
            yield shot, render_view(header, shot.frame.splats, shot.view, **show.of_view)


def picture_camera(header: StreamHeader, wanted: str | CameraPath, show: Show) -> Camera:
    """A camera of the name and size of every picture; raises UsageError when that is no size a picture can have."""
    camera = scaled_view(camera_of(header, first_view(wanted)), show.scale)
    if show.layout is None:
        return camera
    whole = show.layout.picture_of(camera)
    check_picture(whole, show.max_memory, lens=True, layers=True)  # a layout's own tables and sums
    return whole


def _laid_out(header: StreamHeader, shot: Shot, show: Show, layout: Layout) -> Rendering:
    """The picture of several renderings, with what the view's camera recorded of colours."""
    correction = _correction(header, shot, show)
    camera = standing_camera(header, shot.view, scale=show.scale, undistorted=show.undistorted, correction=correction)
    how = show.of_view | {"scale": 1.0, "undistorted": False}
    seen = layout.render(header, shot.frame.splats, camera, how)
    behind = behind_subject(header, show.over(header))
    if correction is None:
        return seen
    return with_recorded_colours(
        seen, camera, replace(correction, falloff=0, lamp=None), behind
    )  # no lens and no rows made it


def with_layers(
    header: StreamHeader, shots: Iterator[Shot], wanted: str | CameraPath, show: Show, static: Ids | None
) -> Iterator[tuple[Shot, Rendering, Layers]]:
    """The pictures asked for with all their layers; a shot is taken when the one after it is known.

    ``static``: the ids of Gaussians that never change, None where nobody knows them.
    """
    taken: deque[tuple[Shot | None, Shot | None]] = deque()

    def middle_ones() -> Iterator[Shot]:
        before: Shot | None = None
        shot = next(shots, None)
        while shot is not None:
            after = next(shots, None)
            if shot.is_asked_for:
                taken.append((before, after))
                yield shot
            before, shot = shot, after

    for shot, picture in pictures(header, middle_ones(), wanted, show):
        before, after = taken.popleft()
        yield shot, picture, _layers(header, before, shot, after, show, static)


def _layers(
    header: StreamHeader, before: Shot | None, shot: Shot, after: Shot | None, show: Show, static: Ids | None
) -> Layers:
    correction = _correction(header, shot, show)
    plan = _plan(header, shot, show)
    check_picture(plan.camera, show.max_memory, lens=not plan.is_identity, rendered=plan.render_camera, layers=True)
    pairs = max_pairs(header, len(shot.frame.state), plan, show.max_memory)

    def motion(other: Shot | None) -> FloatArray | None:
        if other is None:
            return None
        turned = _correction(header, other, show)
        seen_by = standing_camera(header, other.view, scale=show.scale, undistorted=show.undistorted, correction=turned)
        return motion_to(shot.frame, other.frame, seen_by, plan, show.threads, pairs)

    background = None if show.cut_out else recorded_colour(show.over(header), correction)
    dynamic = (
        None
        if static is None
        else dynamic_part(shot.frame.splats, shot.frame.state.ids, static, plan, show.threads, pairs)
    )
    return Layers(plan.camera, background, dynamic, motion(after), motion(before))


def _plan(header: StreamHeader, shot: Shot, show: Show) -> Redistortion:
    correction = _correction(header, shot, show)
    return view_plan(header, shot.view, scale=show.scale, undistorted=show.undistorted, correction=correction)


def _correction(header: StreamHeader, shot: Shot, show: Show) -> Correction | None:
    return None if show.drift_free else correction_of(header, shot.view, shot.frame.corrections)
