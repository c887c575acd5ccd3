"""Writes decoded frames as pictures: a folder of PNG, single PNG or EXR files, or a video, chosen by the output's name.

======================  ==============================================================================
output                  what is written
======================  ==============================================================================
a folder (no suffix)    ``<view>_<frame>.png``, one per frame, names that sort
``x.png``, ``x.exr``    that file for a single frame, ``x_<frame>.png`` and so on for several
``x_####.exr``          one file per frame, its index in place of the pattern (``decogs.formats.frames.names``)
``x.mp4``, ``x.mov``    a video at the stream's frame rate, see ``decogs.decoder.output.video``
``x.y4m``, ``x.rgb``    uncompressed video, see ``decogs.decoder.output.raw_video``; an open file takes Y4M
======================  ==============================================================================

PNG and videos hold the display-referred picture rounded to 8 bit. EXR is for compositing, see
``decogs.decoder.output.exr``. Of a subject over nothing, PNG and ProRes hold straight colours and alpha.

Everything is written into a hidden folder beside the output and moved to its name at the end: an error or an
interruption leaves nothing under the output's name and nothing of what stood there before is touched. Only when a
stream is followed while it grows does each picture appear as soon as it is whole (a video still at the end).
"""

from __future__ import annotations

import os
import re
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from decogs.formats.errors import UsageError, check_utf8
from decogs.formats.files.outputs import ENDINGS, errors_named, publish_files, staged_files
from decogs.formats.frames.names import names_of_frames
from decogs.formats.splats import FloatArray

from ..cameras.path import DEFAULT_FPS as DEFAULT_FPS
from ..rasterise.straight_alpha import straight_picture
from .exr import Layers, save_exr
from .raw_video import RawVideo
from .video import CODECS, Movie, VideoSettings, check_settings

if TYPE_CHECKING:
    from ..rasterise import Rendering


_RAW = frozenset({".y4m", ".rgb"})
_WRITTEN = frozenset({".png", ".exr", *CODECS, *_RAW})
_LONGEST_VIEW = 200
"""Bytes of a view's name in a file name, which may have 255 in all."""

_SLOWEST, _FASTEST = 0.01, 1000.0
"""Frames per second that every video coder takes; its time stamps have 16 bits of fraction."""

_PNG_STRATEGY = zlib.Z_RLE
"""How PNG files are deflated: a little larger than by the default, four times as fast."""


class PictureSink(ABC):
    """Takes the frames of one view in order; ``finish`` completes what was written.

    ``has_layers``: whether ``write`` wants the layers of the picture, too. ``has_alpha``: whether it wants a subject
    over black, whose alpha it keeps. ``file_of``: where the picture of a frame will lie, when each has a file of its
    own.
    """

    has_layers = False
    has_alpha = False
    file_of: Callable[[int], Path] | None = None

    @abstractmethod
    def write(self, frame: int, rendering: Rendering, layers: Layers | None = None) -> None:
        """Adds the picture of the frame with this index."""

    @abstractmethod
    def finish(self) -> None:
        """Completes the files, so that they can be moved to their final names."""


@contextmanager
def open_sink(
    output: str | os.PathLike[str] | BinaryIO,
    *,
    view: str,
    frames: int | None,
    fps: float | None,
    video: VideoSettings = VideoSettings(),  # noqa: B008 (frozen)
    cut_out: bool = False,
    sound: Iterator[FloatArray] | None = None,
) -> Iterator[PictureSink]:
    """A sink for ``frames`` pictures of ``view``, whose files appear under ``output`` when the block ends well.

    An open file takes uncompressed video as it comes. ``video``: how a video is encoded. ``frames`` None: nobody knows
    how many will come. Files of single pictures then appear each as soon as it is whole. ``cut_out``: the pictures are
    those of a subject over nothing, whose alpha is kept where the output can hold it (``has_alpha``). ``sound``: stereo
    samples at 48 kHz from the first picture on, for a video.

    Raises UsageError when the output's kind is unknown or it cannot be written.
    """
    if not isinstance(output, (str, os.PathLike)):
        check_settings("", video)
        yield (raw := _Raw(output, "standard output", fps or DEFAULT_FPS, y4m=True))
        raw.flush()
        return
    target = Path(output)
    create, folder = _plan(output, target, view, frames, fps or DEFAULT_FPS, video, cut_out, sound)
    with staged_files(folder) as staging:
        sink = create(staging)
        if frames is None and isinstance(sink, _Files):
            sink = _OneByOne(sink, staging, folder)
        if isinstance(sink, (_Files, _OneByOne)):
            name_of = sink.name_of
            sink.file_of = lambda frame: folder / name_of(frame)
        yield sink
        sink.finish()


def holds_sound(output: str | os.PathLike[str] | BinaryIO) -> bool:
    """Whether this kind of output has a place for sound."""
    return isinstance(output, (str, os.PathLike)) and Path(output).suffix.lower() in CODECS


def to_8bit(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Display-referred 0..1 to 0..255: clipped and rounded to nearest. The one rounding of every 8-bit picture."""
    rounded: NDArray[np.uint8] = np.rint(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)
    return rounded


class _Files(PictureSink):
    """One PNG per frame."""

    def __init__(self, name_of: Callable[[int], str], folder: Path, cut_out: bool) -> None:
        self.name_of, self._folder, self.has_alpha = name_of, folder, cut_out

    def write(self, frame: int, rendering: Rendering, layers: Layers | None = None) -> None:
        _save_png(self._folder / self.name_of(frame), _picture(rendering, self.has_alpha))

    def finish(self) -> None:
        """Every file is complete as soon as it is written."""


class _ExrFiles(_Files):
    """One EXR per frame, with its layers."""

    has_layers = True

    def __init__(self, name_of: Callable[[int], str], folder: Path, cut_out: bool, fps: float) -> None:
        super().__init__(name_of, folder, cut_out)
        self._fps = fps

    def write(self, frame: int, rendering: Rendering, layers: Layers | None = None) -> None:
        if layers is None:
            raise ValueError("an EXR needs the layers of its picture")
        save_exr(self._folder / self.name_of(frame), rendering, layers, fps=self._fps)


class _OneByOne(PictureSink):
    """Gives every file its final name as soon as it is whole."""

    def __init__(self, files: _Files, staging: Path, folder: Path) -> None:
        self._files, self._staging, self._folder = files, staging, folder
        self.has_layers, self.has_alpha, self.name_of = files.has_layers, files.has_alpha, files.name_of

    def write(self, frame: int, rendering: Rendering, layers: Layers | None = None) -> None:
        self._files.write(frame, rendering, layers)
        publish_files(self._staging, self._folder)

    def finish(self) -> None:
        """Every file is in place already."""


class _Movie(PictureSink):
    """A video by FFmpeg. 4:2:0 needs even sizes: an odd picture repeats its last row or column."""

    def __init__(
        self, path: Path, fps: float, settings: VideoSettings, cut_out: bool, sound: Iterator[FloatArray] | None
    ) -> None:
        _check_rate(path, fps)
        self._movie = Movie(path, fps, settings, sound)
        self.has_alpha = cut_out and self._movie.codec == "prores"

    def write(self, frame: int, rendering: Rendering, layers: Layers | None = None) -> None:
        self._movie.write(_even(_picture(rendering, self.has_alpha)))

    def finish(self) -> None:
        self._movie.finish()


class _Raw(PictureSink):
    """Uncompressed video; ``name`` is what an error calls the file."""

    def __init__(self, file: BinaryIO, name: str, fps: float, *, y4m: bool) -> None:
        self._file, self._name, self._video = file, name, RawVideo(file, fps, y4m=y4m)

    def write(self, frame: int, rendering: Rendering, layers: Layers | None = None) -> None:
        with errors_named(self._name):
            self._video.write(to_8bit(rendering.image))

    def flush(self) -> None:
        """Hands on what is buffered."""
        with errors_named(self._name):
            self._file.flush()

    def finish(self) -> None:
        with errors_named(self._name):
            self._file.close()


def _even(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height, width = picture.shape[:2]
    return np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def _check_rate(path: Path, fps: float) -> None:
    if not _SLOWEST <= fps <= _FASTEST:
        raise UsageError(
            f"{path.name}: a video cannot have the stream's {fps:g} frames per second; write PNG to a folder"
        )


def _picture(rendering: Rendering, has_alpha: bool) -> NDArray[np.uint8]:
    """Red, green and blue, or straight ones and alpha."""
    return to_8bit(straight_picture(rendering) if has_alpha else rendering.image)


def _save_png(path: Path, picture: NDArray[np.uint8]) -> None:
    from PIL import Image

    try:
        Image.fromarray(picture).save(path, "png", compress_type=_PNG_STRATEGY)
    except OSError as error:
        raise UsageError(
            f"{path.name}: cannot be written ({error.strerror}); free some space or choose another output"
        ) from None


def _plan(
    output: str | os.PathLike[str],
    target: Path,
    view: str,
    frames: int | None,
    fps: float,
    video: VideoSettings,
    cut_out: bool,
    sound: Iterator[FloatArray] | None,
) -> tuple[Callable[[Path], PictureSink], Path]:
    """How to make the sink in a staging folder, and the folder that its files are to be moved to."""
    if str(output) == "-":
        raise UsageError(
            "-: give an open binary file for a pipe, or name a folder, a .png, .exr, .mp4, .mov or .y4m file"
        )
    suffix = "" if str(output).endswith(("/", os.sep)) or target.is_dir() else target.suffix.lower()
    if suffix in ENDINGS - _WRITTEN:
        raise UsageError(
            f"{target}: {suffix} is not written; name a folder (PNG), or a .png, .exr, .mp4, .mov or .y4m file"
        )
    check_settings(suffix, video)
    if suffix in (".mp4", ".mov", ".exr"):
        check_utf8(target)
    if suffix in CODECS:
        return lambda folder: _Movie(folder / target.name, fps, video, cut_out, sound), target.parent
    if suffix in _RAW:
        return lambda folder: _raw_file(folder / target.name, target, fps), target.parent
    if suffix not in (".png", ".exr"):
        if target.exists() and not target.is_dir():
            raise UsageError(
                f"{target}: is a file, not a folder; name a folder (PNG), or a .png, .exr, .mp4, .mov or .y4m file"
            )
        safe = _safe(view)
        return lambda folder: _Files(lambda frame: f"{safe}_{frame:06d}.png", folder, cut_out), target
    name_of = names_of_frames(target, frames)
    if suffix == ".exr":
        return lambda folder: _ExrFiles(name_of, folder, cut_out, fps), target.parent
    return lambda folder: _Files(name_of, folder, cut_out), target.parent


def _raw_file(path: Path, target: Path, fps: float) -> _Raw:
    return _Raw(path.open("wb"), str(target), fps, y4m=path.suffix.lower() == ".y4m")


def _safe(view: str) -> str:
    """The view's name as the beginning of a file name, cut where that would be too long."""
    safe = re.sub(r"[^\w.-]+", "_", view).lstrip(".")
    try:
        os.fsencode(safe)
    except UnicodeEncodeError:  # names of files are ASCII here
        safe = re.sub(r"[^\w.-]+", "_", safe, flags=re.ASCII)
    return safe.encode()[:_LONGEST_VIEW].decode(errors="ignore") or "view"
