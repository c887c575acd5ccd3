"""The one result of every rig reader, and the checks that hold for every layout."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..cameras import Camera, scale_camera
from ..errors import RigError, UsageError
from ..files.unicode_forms import composed
from ..frames.rates import exact_rate
from ..videos.reading import VideoSource
from .sources import FrameSource, PictureSource, natural_key
from .timeline import RigTime, Timeline


@dataclass(frozen=True)
class Points:
    """Surface points that came with the calibration: xyz (P, 3) float32 in world units, rgb (P, 3) uint8."""

    xyz: NDArray[np.float32]
    rgb: NDArray[np.uint8]

    def __len__(self) -> int:
        return int(self.xyz.shape[0])


@dataclass(frozen=True)
class Rig:
    """Synchronised, calibrated, fixed cameras; frame k of every source is the same instant, which `in_step` sees to.

    ``cameras`` and ``sources`` are parallel, in natural order of the camera names; each camera has the size of its
    source. ``fps``: as a stream is played, as stated or else as recorded; None where nothing tells. ``timeline``: the
    clocks of its cameras. ``recordings``: by camera, the whole source of which only a part is used. ``calibration``:
    the files that the cameras and points were read from. ``warnings``: what the user should know, one line each.
    ``length_unit``: a world unit in words, where the calibration has one. ``ignore_masks``: by camera, the pictures
    that the calibration names for pixels that teach nothing, which are black; each once. ``starts``: by camera, when
    its first picture was taken, on a common clock, as the calibration states it.
    """

    path: Path
    layout: str
    cameras: tuple[Camera, ...]
    sources: tuple[FrameSource, ...]
    fps: float | None
    frame_count: int
    points: Points | None = None
    source_text: str = ""
    licence: str = ""
    calibration: tuple[Path, ...] = ()
    warnings: tuple[str, ...] = ()
    length_unit: str = ""
    ignore_masks: Mapping[str, tuple[Path, ...]] = field(default_factory=dict)
    starts: Mapping[str, RigTime] = field(default_factory=dict)
    timeline: Timeline = field(default_factory=Timeline)
    recordings: Mapping[str, FrameSource] = field(default_factory=dict)

    def recording(self, camera: str) -> FrameSource:
        """The whole recording of a camera, also where only a part of it is used."""
        names = [each.name for each in self.cameras]
        return self.recordings.get(camera, self.sources[names.index(camera)])


def assemble_rig(
    path: Path,
    layout: str,
    pairs: Sequence[tuple[Camera, FrameSource]],
    calibration: Sequence[Path],
    *,
    resizable: bool,
    fps: float | None = None,
    points: Points | None = None,
    source_text: str = "",
    licence: str = "",
    length_unit: str = "",
) -> Rig:
    """Cross-checks the cameras and their sources, and puts them in natural order; not yet in step (`steps.in_step`).

    ``resizable``: the calibration may be for another resolution of the same picture (all cameras by the same factor);
    its intrinsics are then rescaled. ``fps`` overrides the videos' own rate.
    Raises RigError naming the file that differs from the others.
    """
    if not pairs:
        raise RigError(f"{path}: the calibration lists no cameras; calibrate the rig again")
    pairs = [(replace(camera, name=composed(camera.name)), source) for camera, source in pairs]
    _check_names(path, [camera.name for camera, _ in pairs])
    ordered = [
        (camera, _as_calibrated(camera, source, resizable))
        for camera, source in sorted(pairs, key=lambda pair: natural_key(pair[0].name))
    ]
    sources = tuple(source for _, source in ordered)
    cameras = tuple(_fit_to_source(camera, source, resizable) for camera, source in ordered)
    _check_one_scale([camera for camera, _ in ordered], sources)
    return Rig(
        path,
        layout,
        cameras,
        sources,
        fps,
        min(source.frame_count for source in sources),
        points,
        source_text,
        licence,
        tuple(calibration),
        tuple(_warnings(sources)),
        length_unit,
        timeline=_timeline(cameras, sources, fps),
    )


def _timeline(cameras: Sequence[Camera], sources: Sequence[FrameSource], stated: float | None) -> Timeline:
    """Of the recordings' rate, with the readouts that their videos state."""
    timeline = Timeline(recorded_rate(sources, stated))
    readouts = {
        camera.name: source.readout
        for camera, source in zip(cameras, sources, strict=True)
        if isinstance(source, VideoSource) and source.readout
    }
    return timeline.with_readouts(readouts) if timeline.rate else timeline


def recorded_rate(sources: Sequence[FrameSource], stated: float | None) -> Fraction | None:
    """Frames per second of the slowest recording; as ``stated`` where none has a rate, None where nothing tells."""
    rate = min((fps for _, fps in with_rates(sources)), default=stated)
    return None if rate is None else exact_rate(rate)


def with_rates(sources: Sequence[FrameSource]) -> list[tuple[FrameSource, float]]:
    """The recordings that have a rate, which one picture has not, with their frames per second."""
    return [(source, source.fps) for source in sources if source.fps is not None and source.frame_count > 1]


def without_cameras(rig: Rig, names: Collection[str]) -> Rig:
    """The rig without the cameras of these ``names``, as if they had never been there.

    Raises UsageError for a name that no camera has, or where none is left.
    """
    unknown = sorted(set(names) - {camera.name for camera in rig.cameras})
    if unknown:
        names_of_rig = ", ".join(camera.name for camera in rig.cameras)
        raise UsageError(f"`exclude` {unknown[0]}: {rig.path} has no such camera; its cameras are {names_of_rig}")
    kept = [k for k, camera in enumerate(rig.cameras) if camera.name not in names]
    if not kept:
        raise UsageError(f"`exclude`: no camera of {rig.path} is left; leave at least one")
    return replace(rig, cameras=tuple(rig.cameras[k] for k in kept), sources=tuple(rig.sources[k] for k in kept))


def _warnings(sources: Sequence[FrameSource]) -> Iterator[str]:
    """What the frames say of themselves that is not an error, but shows in what becomes of them."""
    for text in dict.fromkeys(text for source in sources for text in source.warnings):
        those = [source for source in sources if text in source.warnings]
        yield f"{those[0].path}{more(those)}: {text}"


def more(items: Sequence[object]) -> str:
    """ " and 3 more" than the first, for a message; empty where there is one."""
    return f" and {len(items) - 1} more" if len(items) > 1 else ""


def _check_names(path: Path, names: list[str]) -> None:
    # Names become file names and stream fields.
    bad = [name for name in names if not name.strip() or not name.isprintable() or set(name) & set("/\\")]
    if bad:
        raise RigError(f"{path}: {bad[0]!r} is no usable camera name; use letters, digits, '_' and '-'")
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise RigError(f"{path}: two cameras are called {twice[0]!r}; give every camera its own name")


def usual(values: Sequence[Hashable]) -> int:
    """Index of the first camera that has the most common value."""
    return values.index(Counter(values).most_common(1)[0][0])


def _as_calibrated(camera: Camera, source: FrameSource, resizable: bool) -> FrameSource:
    """The source, turned by its pictures' EXIF orientation if only then they are what was calibrated.

    Where the stored pictures fit, they stay as they are stored, as in COLMAP; so do all square ones. A video has the
    edges that its clean aperture leaves out where its size was calibrated with them.
    """
    if isinstance(source, VideoSource) and any(source.edges):
        return _with_edges_as_calibrated(camera, source)
    if _fits(camera, source, resizable) or not isinstance(source, PictureSource):
        return source
    turned = source.turned()
    return turned if turned is not None and _fits(camera, turned, resizable) else source


def _with_edges_as_calibrated(camera: Camera, source: VideoSource) -> VideoSource:
    size, whole = (camera.width, camera.height), source.whole()
    if size == (whole.width, whole.height):
        return whole
    if size == (source.width, source.height):
        return source
    warning = (
        f"is cropped to its clean aperture, {source.width} x {source.height} of {whole.width} x {whole.height} pixels; "
        "if the cameras were calibrated with all of them, state the calibration at that size"
    )
    return replace(source, warnings=(*source.warnings, warning))


def _fits(camera: Camera, source: FrameSource, resizable: bool) -> bool:
    """Whether the source has the calibrated size or, where it may be resized, its shape."""
    # A resized picture keeps its shape up to the rounding of its sides.
    skew = abs(source.width * camera.height - source.height * camera.width)
    same_shape = skew <= max(camera.width, camera.height, source.width, source.height)
    return (camera.width, camera.height) == (source.width, source.height) or (resizable and same_shape)


def _fit_to_source(camera: Camera, source: FrameSource, resizable: bool) -> Camera:
    """The camera at its source's size."""
    if (camera.width, camera.height) == (source.width, source.height):
        return camera
    if not _fits(camera, source, resizable):
        raise RigError(
            f"{source.path}: {source.width} x {source.height} pixels, but camera {camera.name} is calibrated for "
            f"{camera.width} x {camera.height}; "
            + ("resize the pictures without cropping" if resizable else "correct the calibration's size and intrinsics")
        )
    fitted = scale_camera(camera, source.width / camera.width)
    if fitted.height != source.height:
        ratio = source.height / camera.height
        fitted = replace(fitted, height=source.height, fy=camera.fy * ratio, cy=camera.cy * ratio)
    return fitted


def _check_one_scale(calibrated: Sequence[Camera], sources: Sequence[FrameSource]) -> None:
    scales = [source.width / camera.width for camera, source in zip(calibrated, sources, strict=True)]
    most = usual([round(scale, 2) for scale in scales])
    for source, scale in zip(sources, scales, strict=True):
        if abs(scale - scales[most]) > 0.02 * scales[most]:
            raise RigError(
                f"{source.path}: {source.width} x {source.height} pixels is {scale:.2f} times its calibrated size, "
                f"but {sources[most].path.name} is {scales[most]:.2f} times; resize all cameras alike"
            )
