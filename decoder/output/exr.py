"""Writes a rendering as an EXR for compositing: premultiplied linear colour, coverage, depth, motion, camera.

Channels: half R, G, B and A, premultiplied; float Z; half ``trained.A``; and, where the layers are known, half
``dynamic.A`` and float ``forward.u``, ``forward.v``, ``backward.u``, ``backward.v``.

*The colours have no background, and ``over`` with the stream's own gives the decoder's picture.* Gaussians are blended
in display-referred values, c + (1 - a) b, and ``over`` blends linear light, so that no premultiplied colour suits
every background b. With f for the sRGB transfer function undone, the colour written is

    C = f(c + (1 - a) b) - (1 - A) f(b)

for the one b that was trained against (or the ``background`` asked for): C + (1 - A) f(b) is then the picture, whatever
the coverage A. Over a black background, the default, C = f(c). Over another b the error is that of blending there.

*A is what surfaces cover, not what was trained.* Training compares c + (1 - a) b with opaque recordings and is free to
let b stand in for a surface's dark colour: brick has a = .8, mortar lines .5, black print .2. So A is
min(1, a / SOLID_FROM), at the price of edges that are up to a pixel wider before nothing at all. The trained a is
``trained.A``.

*A subject's a is trained to be what it covers*, whatever is behind it. There A = a, without ``trained.A``, and
C = a f(c / a): what a compositing program makes of the straight PNG, for every background.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera
from decogs.formats.colours.srgb import linear_from_srgb
from decogs.formats.errors import UsageError
from decogs.formats.frames.rates import exact_rate
from decogs.formats.splats import FloatArray

from ..rasterise.straight_alpha import straight_colours

if TYPE_CHECKING:
    from ..rasterise import Rendering

NOTHING_SEEN = 1e10
"""Depth where no splat is: far behind everything, as compositing programs expect."""

SOLID_FROM = 0.2
"""Trained alpha from which a pixel counts as covered; below, coverage falls with it to 0."""

_HALF_MAX = 65504.0
_NEAR, _FAR = 0.01, 10_000.0
"""Planes that worldToNDC's third coordinate runs between; nothing is clipped there."""


@dataclass(frozen=True)
class Layers:
    """What an EXR holds beside colour, alpha and depth.

    ``camera``: that of the picture. ``background``: display-referred RGB of ``over``, as the picture shows it; None for
    a subject, whose picture is then the one over black.
    ``dynamic`` (H, W): the part, 0 to 1, that Gaussians which ever change have in what the pixel shows; None where
    nobody knows.
    ``forward`` and ``backward`` (H, W, 2): where what the pixel shows goes in the next picture, and where it was in the
    one before, in pixels from here, u to the right and v upwards; None at the film's ends.
    """

    camera: Camera
    background: tuple[float, float, float] | None
    dynamic: FloatArray | None = None
    forward: FloatArray | None = None
    backward: FloatArray | None = None


def linear_light(image: NDArray[Any]) -> NDArray[np.float32]:
    """sRGB-coded values to linear light (IEC 61966-2-1), continued above 1 and, mirrored, below 0."""
    return np.asarray(np.copysign(linear_from_srgb(np.abs(image, dtype=np.float32)), image), dtype=np.float32)


def coverage(alpha: FloatArray) -> FloatArray:
    """What surfaces cover of each pixel, 0 to 1, from the alpha that was trained."""
    return np.asarray(np.minimum(alpha / np.float32(SOLID_FROM), 1), np.float32)


def without_background(
    image: FloatArray, covered: FloatArray, background: tuple[float, float, float]
) -> NDArray[np.float32]:
    """Premultiplied linear colour (H, W, 3) whose ``over`` with ``background`` is the display-referred ``image``."""
    behind = linear_light(np.asarray(background, np.float32))
    return np.asarray(linear_light(image) - (1 - covered[..., None]) * behind, np.float32)


def camera_matrices(camera: Camera) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """worldToCamera and worldToNDC as RenderMan writes them: for row vectors, camera x right, y up, z forward.

    NDC is -1..1 from left to right and from bottom to top, after the division by w; without lens distortion.
    """
    to_camera = np.diag([1.0, -1.0, 1.0, 1.0]) @ camera.world_to_camera
    width, height = camera.width, camera.height
    to_ndc = np.zeros((4, 4))
    to_ndc[0, 0], to_ndc[0, 2] = 2 * camera.fx / width, 2 * camera.cx / width - 1
    to_ndc[1, 1], to_ndc[1, 2] = 2 * camera.fy / height, 1 - 2 * camera.cy / height
    to_ndc[2, 2], to_ndc[2, 3] = _FAR / (_FAR - _NEAR), -_FAR * _NEAR / (_FAR - _NEAR)
    to_ndc[3, 2] = 1
    # OpenEXR takes the memory of an array, whatever its strides.
    return np.array(to_camera.T, np.float32, order="C"), np.array((to_ndc @ to_camera).T, np.float32, order="C")


def save_exr(path: Path, rendering: Rendering, layers: Layers, *, fps: float) -> None:
    """Writes the file; raises UsageError when it cannot be."""
    import OpenEXR

    channels = {name: np.ascontiguousarray(plane) for name, plane in _channels(rendering, layers).items()}
    to_camera, to_ndc = camera_matrices(layers.camera)
    rate = exact_rate(fps)
    header = {
        "type": OpenEXR.scanlineimage,
        "compression": OpenEXR.ZIP_COMPRESSION,
        "chromaticities": (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329),
        "framesPerSecond": (rate.numerator, rate.denominator),
        "worldToCamera": to_camera,
        "worldToNDC": to_ndc,
        **_about_colours(layers.background),
        "decogs:depth": "along the view axis, world units; the mean of what the pixel shows, which lies between near "
        f"and far at silhouettes; {NOTHING_SEEN:g} where nothing is seen",
        "decogs:camera": "matrices for row vectors; camera x right, y up, z forward; NDC -1 to 1; no lens distortion",
        "decogs:fps": f"{fps:g}",
    }
    if layers.forward is not None or layers.backward is not None:
        header["decogs:motion"] = "pixels from here, u right, v up, to the next and to the previous picture"
    try:
        with OpenEXR.File(header, channels) as file:
            file.write(str(path))
    except RuntimeError as error:
        problem = str(error).replace(str(path), path.name)  # It lies in a hidden folder by now.
        raise UsageError(f"{path.name}: the EXR cannot be written ({problem}); choose another output") from None


def _about_colours(background: tuple[float, float, float] | None) -> dict[str, str]:
    linear = "linear light, Rec. 709 primaries, premultiplied, without background"
    if background is None:
        return {"decogs:colour": linear, "decogs:alpha": "A is what the subject covers"}
    return {
        "decogs:colour": f"{linear}; over the background below it is the decoder's picture, over others it is blended "
        "in linear light, which the scene was not",
        "decogs:background": " ".join(f"{value:g}" for value in background) + " (display-referred sRGB)",
        "decogs:alpha": f"A is 1 from a trained alpha of {SOLID_FROM:g} on; trained.A is that alpha",
    }


def _channels(rendering: Rendering, layers: Layers) -> dict[str, NDArray[Any]]:
    if layers.background is None:
        covered = rendering.alpha
        rgb = covered[..., None] * linear_light(straight_colours(rendering.image, covered))
    else:
        covered = coverage(rendering.alpha)
        rgb = without_background(rendering.image, covered, layers.background)
    rgb = np.clip(rgb, -_HALF_MAX, _HALF_MAX)
    seen = (rendering.alpha > 0) & (rendering.depth > 0)
    channels: dict[str, NDArray[Any]] = {
        **{name: rgb[..., k].astype(np.float16) for k, name in enumerate("RGB")},
        "A": covered.astype(np.float16),
        "Z": np.where(seen, rendering.depth, np.float32(NOTHING_SEEN)).astype(np.float32),
    }
    if layers.background is not None:
        channels["trained.A"] = rendering.alpha.astype(np.float16)
    if layers.dynamic is not None:
        channels["dynamic.A"] = (layers.dynamic * covered).astype(np.float16)
    for name, motion in (("forward", layers.forward), ("backward", layers.backward)):
        if motion is not None:
            channels |= {f"{name}.{axis}": motion[..., k].astype(np.float32) for k, axis in enumerate("uv")}
    return channels
