"""The picture of a view of a scene: camera, lens, the frame's corrections of the camera, and the rendering.

``render_view`` is the one way from splats to a picture: the decoder's commands and the encoder's preview both use it,
which is why their pixels are equal.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.corrections import Correction, Corrections, with_colours
from decogs.formats.cameras import Camera, as_pinhole, is_distorted, scale_camera
from decogs.formats.errors import UsageError
from decogs.formats.splats import Splats

from ..cameras.corrections import apply_gain, as_it_stood, with_recorded_colours
from ..cameras.lens import Redistortion
from ..limits import MAX_PICTURE_PIXELS, check_picture, pairs_within

if TYPE_CHECKING:
    from ..rasterise import Rendering


def render_view(
    header: StreamHeader,
    splats: Splats,
    view: str | Camera,
    *,
    scale: float = 1.0,
    background: tuple[float, float, float] | None = None,
    undistorted: bool = False,
    threads: int = 0,
    corrections: Corrections | None = None,
    max_memory: int | None = None,
) -> Rendering:
    """What a camera of the rig (by name), or any other camera, sees of a frame: image, alpha and depth.

    The picture has the camera's own size times ``scale``, and its lens distortion unless ``undistorted``.
    ``corrections``: the frame's; a camera of the rig then shows what it recorded, from where it stood in that frame and
    with its exposure and white balance. Without them, and from any other camera, it is the scene's own colours.
    ``background``: display-referred RGB, the header's when None; it also fills what a lens sees past the rendered
    pinhole. ``threads`` 0 means all processors. Raises UsageError for an unknown camera, an impossible size, and what
    needs more than ``max_memory`` bytes, the scene included.
    """
    from ..rasterise import render

    correction = correction_of(header, view, corrections)
    plan = view_plan(header, view, scale=scale, undistorted=undistorted, correction=correction, max_memory=max_memory)
    background = header.background if background is None else background
    pairs = max_pairs(header, len(splats), plan, max_memory)
    drawn = render(splats, plan.render_camera, background, threads=threads, max_pairs=pairs)
    seen = through_lens(plan, drawn, background)
    if correction is None:
        return seen
    return with_recorded_colours(seen, plan.camera, correction, behind_subject(header, background))


def camera_of(header: StreamHeader, view: str | Camera) -> Camera:
    """The camera that a view is: one of the rig by name, or any other; raises UsageError for an unknown name."""
    if not isinstance(view, str):
        return view
    for camera in header.cameras:
        if camera.name == view:
            return camera
    names = [camera.name for camera in header.cameras]
    listed = ", ".join(names[:40]) + (", ..." if len(names) > 40 else "")
    raise UsageError(f"there is no camera {view!r} in this stream; it has {listed}")


def correction_of(header: StreamHeader, view: str | Camera, corrections: Corrections | None) -> Correction | None:
    """That of a rig camera, by name, in a frame with these ``corrections``; None where nothing is corrected."""
    if corrections is None or not isinstance(view, str):
        return None
    colours = header.colours_of(view)
    if colours is None:
        return corrections.get(view)
    return with_colours(corrections.get(view, Correction()), colours)


def behind_subject(header: StreamHeader, background: tuple[float, float, float]) -> tuple[float, float, float] | None:
    """The background where it is no part of what was recorded: behind a subject. None for a whole scene."""
    return background if header.subject else None


def view_plan(
    header: StreamHeader,
    view: str | Camera,
    *,
    scale: float,
    undistorted: bool,
    correction: Correction | None = None,
    max_memory: int | None = None,
) -> Redistortion:
    """What to render for the view that ``render_view`` takes, and the way from there to its own pixels."""
    camera = standing_camera(header, view, scale=scale, undistorted=undistorted, correction=correction)
    lens = is_distorted(camera)
    if max_memory is not None:
        check_picture(camera, max_memory, lens=lens)  # before its tables are made
    plan = Redistortion(camera)
    if max_memory is not None:
        check_picture(camera, max_memory, lens=lens, rendered=plan.render_camera)
    return plan


def standing_camera(
    header: StreamHeader, view: str | Camera, *, scale: float, undistorted: bool, correction: Correction | None = None
) -> Camera:
    """The camera of the picture that ``render_view`` makes, its lens included."""
    camera = scaled_view(camera_of(header, view), scale)
    if correction is not None:
        camera = as_it_stood(camera, correction)
    return as_pinhole(camera) if undistorted else camera


def recorded_colour(colour: tuple[float, float, float], correction: Correction | None) -> tuple[float, float, float]:
    """A colour of the scene as the corrected camera recorded it."""
    if correction is None or not correction.has_gain:
        return colour
    red, green, blue = apply_gain(np.asarray(colour, np.float32), correction.odds_gain).tolist()
    return red, green, blue


def max_pairs(header: StreamHeader, gaussians: int, plan: Redistortion, max_memory: int | None) -> int:
    """How many pairs of a 16x16 tile and a Gaussian a picture of so many Gaussians may list."""
    from ..rasterise.native import MAX_PAIRS

    if max_memory is None:
        return MAX_PAIRS
    lens = not plan.is_identity
    return min(
        MAX_PAIRS,
        pairs_within(max_memory, gaussians, header.coefficients, plan.camera, plan.render_camera, lens=lens),
    )


def through_lens(plan: Redistortion, seen: Rendering, background: tuple[float, float, float]) -> Rendering:
    """The rendering of ``plan.render_camera`` as the view's own camera sees it; the same object without a lens."""
    from ..rasterise import Rendering

    if plan.is_identity:
        return seen
    return Rendering(
        plan.apply(seen.image, outside=background),
        np.clip(plan.apply(seen.alpha), 0.0, 1.0),
        plan.apply(seen.depth, nearest=True),
    )


def scaled_view(camera: Camera, scale: float) -> Camera:
    """The camera at ``scale`` times its size; raises UsageError when that is no size a picture can have."""
    if not (np.isfinite(scale) and scale > 0):
        raise UsageError(f"a scale of {scale:g} is not possible; give one above 0, such as 0.5")
    if scale * camera.width * scale * camera.height <= 2 * MAX_PICTURE_PIXELS:  # a far larger one is no camera at all
        scaled = scale_camera(camera, scale)
        if scaled.width * scaled.height <= MAX_PICTURE_PIXELS:
            return scaled
    raise UsageError(
        f"camera {camera.name!r}: {scale:g} times its {camera.width}x{camera.height} is above the limit of "
        f"{MAX_PICTURE_PIXELS} pixels; choose a smaller scale"
    )
