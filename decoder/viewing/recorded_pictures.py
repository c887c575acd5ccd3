"""The pictures that a rig's cameras recorded, for the player to lay beside what the stream shows.

A stream has no pictures. Whoever looks at one on the machine where its rig lies can have both: the rig is opened as the
encoder does, and only the frames of its cameras are ever read.
"""

from __future__ import annotations

import io
import os
import threading
from collections import OrderedDict
from collections.abc import Generator
from typing import TYPE_CHECKING

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.formats.colours.srgb import srgb_from_linear
from decogs.formats.errors import RigError, UsageError
from decogs.formats.pictures.reading import Picture

if TYPE_CHECKING:
    from decogs.formats.rigs import FrameSource

FOLDER = "recorded/"
_KEPT = 64
"""Pictures as files, the ones asked for last."""

_QUALITY = 95
"""Of JPEG: fine enough to compare with, a tenth of PNG's time for large pictures."""


class RecordedPictures:
    """A rig's frames as JPEG files, by camera and frame of the stream; safe to ask from several threads."""

    address = f"./{FOLDER}{{camera}}/{{frame}}.jpg"
    """Where the page finds them: a template with the camera's name and the frame."""

    def __init__(self, rig: str | os.PathLike[str], header: StreamHeader) -> None:
        """Raises RigError for what is no rig, UsageError for one that has none of the stream's cameras or frames."""
        from decogs.formats.rigs import open_rig

        opened = open_rig(rig)
        names = {camera.name for camera in header.cameras}
        pairs = zip(opened.cameras, opened.sources, strict=True)
        self._sources = {camera.name: source for camera, source in pairs if camera.name in names}
        self._first, self._frames = header.first_frame, opened.frame_count
        if not self._sources:
            raise UsageError(f"{opened.path}: has no camera of the stream; give the rig that it was encoded from")
        if self._first >= self._frames:
            raise UsageError(f"{opened.path}: ends before the stream's first frame; give the rig of that stream")
        self._lock = threading.Lock()
        self._reading: tuple[str, int, Generator[Picture, None, None]] | None = None
        self._files: OrderedDict[tuple[str, int], bytes] = OrderedDict()

    def file_at(self, path: str) -> bytes | None:
        """The file at an unquoted address below the server's, as ``address`` makes it; None where there is none.

        Raises RigError for a frame that cannot be read.
        """
        camera, _, name = path.removeprefix(FOLDER).rpartition("/")
        number = name.removesuffix(".jpg")
        if not path.startswith(FOLDER) or camera not in self._sources or not name.endswith(".jpg"):
            return None
        if not (number.isascii() and number.isdigit() and len(number) < 10):
            return None
        frame = self._first + int(number)
        if frame >= self._frames:
            return None
        with self._lock:
            return self._file(camera, frame)

    def _file(self, camera: str, frame: int) -> bytes:
        wanted = camera, frame
        if wanted not in self._files:
            self._files[wanted] = jpeg(self._picture(self._sources[camera], camera, frame))
        self._files.move_to_end(wanted)
        while len(self._files) > _KEPT:
            self._files.popitem(last=False)
        return self._files[wanted]

    def _picture(self, source: FrameSource, camera: str, frame: int) -> Picture:
        """Goes on where it can: videos are read in sequence."""
        position, self._reading = self._reading, None
        if position is None or position[0] != camera or position[1] > frame:
            if position is not None:
                position[2].close()
            # A video is read from its start however a range begins; other pictures are found by their number.
            position = camera, frame, source.read(frame, self._frames)
        _, first, pictures = position
        for at, picture in enumerate(pictures, first):
            if at == frame:
                self._reading = camera, frame + 1, pictures
                return picture
        raise RigError(f"{source.path}: ends before frame {frame}; bring all cameras to the same number of frames")


def jpeg(picture: Picture) -> bytes:
    """The picture as a JPEG file; scene-linear ones with the sRGB curve, clipped."""
    from PIL import Image

    if picture.dtype != np.uint8:
        shown = np.clip(picture.astype(np.float32), 0.0, 1.0)
        picture = np.rint(srgb_from_linear(shown) * 255).astype(np.uint8)
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "jpeg", quality=_QUALITY)
    return file.getvalue()
