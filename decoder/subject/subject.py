"""A whole scene's stream of which only the subject is shown: Gaussians in the hull of its mattes.

The subject's mattes come from elsewhere, of the pictures that the stream was encoded from.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np

from decogs.codec.packets.corrections import Corrections
from decogs.formats.errors import UsageError
from decogs.formats.mattes import alpha_of, matte_origin, stream_matte_rig
from decogs.formats.pictures.reading import Picture
from decogs.formats.rigs import read_frames
from decogs.formats.rigs.sources import files_of_source
from decogs.formats.splats import FloatArray
from decogs.formats.system.callbacks import OnWarning

from ..cameras.corrections import as_it_stood
from ..cameras.lens import Undistortion
from ..reading.frame import DecodedFrame
from ..reading.stream import Stream
from .hull import Hull, hull_of_mattes, matte_view
from .matte_checks import check_mattes


class SubjectOfStream:
    """The frames of a ``Stream`` with the Gaussians whose centres lie in the hull of the mattes in ``folder``.

    ``chosen``: the frames that must have mattes, of all cameras but those held out. ``header`` is a subject's.
    Raises UsageError where the stream is a subject's, RigError naming a matte that is missing or cannot be one.
    """

    def __init__(self, stream: Stream, folder: Path, chosen: range, on_warning: OnWarning | None) -> None:
        if stream.header.subject:
            raise UsageError(f"{stream.path}: is a subject without a background already; leave out `subject`")
        header = stream.header
        self.path, self.frame_count = stream.path, stream.frame_count
        self.header = replace(header, subject=True)
        self._stream, self._folder = stream, folder
        cameras = [camera for camera in header.cameras if camera.name not in header.held_out]
        self._rig = stream_matte_rig(folder, cameras, header.first_frame, stream.frame_count, chosen)
        self._plans = [Undistortion(camera) for camera in cameras]
        self._check(chosen.start, on_warning)

    def files_read(self) -> list[tuple[Path, str]]:
        """The mattes, and what they are called."""
        files = chain.from_iterable(map(files_of_source, self._rig.sources))
        return [(file, "is read, as `subject`") for file in files]

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[DecodedFrame]:
        """The frames as ``Stream.frames`` has them, of the subject alone.

        Raises RigError where a matte cannot be read; UsageError where no frame shows anything.
        """
        stop = self.frame_count if stop is None else stop
        mattes, shown = read_frames(self._rig, start, stop), 0
        for frame, (_, pictures) in zip(self._stream.frames(start, stop), mattes, strict=True):
            held = self._hull(self._alphas(pictures), frame.corrections).holds(frame.splats.means)
            shown += np.count_nonzero(held)
            yield frame.part(held, self.header)
        if not shown:
            raise UsageError(
                f"{self._folder}: no Gaussian of {self.path} lies where all its mattes are white; are they of these "
                "cameras and frames?"
            )

    def _check(self, frame: int, on_warning: OnWarning | None) -> None:
        """Raises RigError where the mattes of a frame cannot be what they should."""
        ((_, pictures),) = read_frames(self._rig, frame, frame + 1)
        places = [matte_origin(self._rig, camera.name, frame) for camera in self._rig.cameras]
        pinholes = [plan.pinhole for plan in self._plans]
        recorded = [None if plan.valid.all() else plan.valid for plan in self._plans]
        check_mattes(places, pinholes, self._alphas(pictures), recorded, on_warning or (lambda text: None))

    def _alphas(self, pictures: Sequence[Picture]) -> list[FloatArray]:
        """As the pinholes would have them; cubic interpolation overshoots."""
        plans = zip(self._plans, pictures, strict=True)
        return [np.clip(plan.apply(alpha_of(picture)), 0, 1) for plan, picture in plans]

    def _hull(self, alphas: Sequence[FloatArray], corrections: Corrections) -> Hull:
        views = []
        for plan, alpha in zip(self._plans, alphas, strict=True):
            camera, correction = plan.pinhole, corrections.get(plan.camera.name)
            stood = camera if correction is None else as_it_stood(camera, correction)
            recorded = None if plan.valid.all() else plan.valid.astype(np.float32)
            views.append(matte_view(stood, alpha, recorded))
        return hull_of_mattes(views)


AnyStream = Stream | SubjectOfStream
