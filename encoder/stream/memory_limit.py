"""An encode's memory: estimated before it begins, and limited by reading less ahead.

Nearly all of it goes with the pixels of the rig: an encode keeps a few floats for each. What a Gaussian takes, in
training and in the tiles of every view, comes on top. The figures are counted from what is kept, and measured
(`tests/encoder/test_memory_limit.py`): the estimate is over twice what a keyframe takes, a fifth more than what
later frames of 18 large videos take, and hardly more than what they take where they train the whole scene (DESIGN.md,
"Keyframe").
"""

from __future__ import annotations

from dataclasses import dataclass

from decogs.decoder.rasterise.faces import MOST_FACES
from decogs.formats.cameras import is_wide
from decogs.formats.errors import UsageError
from decogs.rig.pictures.ingest import Ingest

from ..frame.cross_fade import fade_cameras
from ..keyframe.first_points import first_points_memory
from ..settings.encode import EncodeSettings
from ..training.method import MAX_GROWTH

_PICTURE_BYTES = 12
"""Bytes of a pixel of a picture, as floats."""
_READ_BYTES = 3
"""Of a pixel of a frame that is read, as the file has it."""
_DECODER_BYTES = 24
"""The same, of what a video's decoder keeps: the pictures that later ones are differences from (H.264: 23)."""
_KEYFRAME_BYTES = 40
"""Of a training pixel while the keyframe is trained: the picture, the same compensated, the shrunk one, what counts in
the loss and what is kept out of it."""
_LATER_FRAME_BYTES = 84
"""Of a training pixel in later frames: the picture, the one before, the reference, the view as it is drawn with depth,
opacity and gradient, masks and weights of the loss."""
_LENS_BYTES = 24
"""Of a training pixel of a camera with a lens: where it lies in the recorded picture, whether it does, as several parts
of the encoder mark it, and of a blank one which recorded one is nearest."""
_MATTE_BYTES = 7
"""Of a training pixel that has a matte: alpha, and the matte as its file has it."""
_CUTTING_BYTES = 160
"""Of a pixel of the largest picture while its subject is keyed, or told from a plate: colours and tones as floats."""
_DRAWN_BYTES = 64
"""Of a pixel of the largest view while it is drawn, compared and differentiated, for each thread."""
_GAUSSIAN_BYTES = 2500
"""Of a Gaussian: values, gradients, moments and copies of them, and its states in the stream."""
_GAUSSIAN_IN_VIEW_BYTES = 1000
"""Of a Gaussian in a view: its projection, and its entries in the tiles that it meets, some ten of them; both again
while it is trained."""
_NEXT_SEGMENT_BYTES = 28
"""Of a training pixel while the next closed segment is trained for a cross-fade: references, the
picture before, masks."""
_FADE_VIEW_BYTES = 52
"""Of a pixel of a view in which two segments are compared: as drawn, its gradient, the mixture, weights."""
_GAUSSIAN_IN_FADE_VIEW_BYTES = 200
"""As `_GAUSSIAN_IN_VIEW_BYTES`, in a small picture."""
_PROGRAM_BYTES = 150 << 20
"""Kernels, libraries and buffers of any encode."""


@dataclass(frozen=True)
class EncodeMemory:
    """What an encode may take, in bytes beyond the program itself, and whether it reads the next frame ahead."""

    size: int
    reads_ahead: bool


def encode_memory(
    ingest: Ingest, settings: EncodeSettings, *, gaussians: int, frames: int, threads: int, reads_ahead: bool
) -> int:
    """The estimate of an encode's memory in bytes, beyond the program itself.

    ``gaussians``: of the keyframe that is taken over, or that the settings' cap allows.
    """
    views = [view.pinhole.width * view.pinhole.height for view in ingest.views]
    every = sum(views) + sum(view.pinhole.width * view.pinhole.height for view in ingest.held_out_views)
    lenses = sum(size for size, view in zip(views, ingest.views, strict=True) if view.valid is not None)
    size = _PROGRAM_BYTES + every * (
        _PICTURE_BYTES + _READ_BYTES + _DECODER_BYTES * (frames > 1) + (_PICTURE_BYTES + _READ_BYTES) * reads_ahead
    )
    if ingest.scale != 1:
        own = [width * height for _, (width, height) in ingest.held_out_sizes.values()]
        size += sum(own) * _READ_BYTES * (1 + reads_ahead) + max(own, default=0) * _DRAWN_BYTES
    if ingest.has_mattes:
        size += every * _MATTE_BYTES * (1 + reads_ahead) + max(views) * _CUTTING_BYTES
    size += lenses * _LENS_BYTES + threads * _DRAWN_BYTES * max(views) + gaussians * _GAUSSIAN_BYTES
    first = sum(views) * _KEYFRAME_BYTES + first_points_memory([view.pinhole for view in ingest.views], threads)
    # Closed segments keep the first frame's pictures, and those of the last cut.
    later = sum(views) * (_LATER_FRAME_BYTES + _PICTURE_BYTES * 2 * settings.closed)
    grown = round(MAX_GROWTH * gaussians)
    drawn = sum(MOST_FACES if is_wide(view.pinhole) else 1 for view in ingest.views)
    later += grown * drawn * _GAUSSIAN_IN_VIEW_BYTES
    if settings.fading:
        later += every * _PICTURE_BYTES * settings.fading + _fade_memory(ingest, grown)
    return size + max(first, later)


def _fade_memory(ingest: Ingest, gaussians: int) -> int:
    """Bytes of training the next closed segment, or of the fade into it, whichever is more."""
    compared = fade_cameras([view.pinhole for view in ingest.views])
    each = sum(camera.width * camera.height for camera in compared) * _FADE_VIEW_BYTES
    segment = sum(view.pinhole.width * view.pinhole.height for view in ingest.views) * _NEXT_SEGMENT_BYTES
    return max(segment, each + gaussians * len(compared) * _GAUSSIAN_IN_FADE_VIEW_BYTES)


def memory_within(
    ingest: Ingest, settings: EncodeSettings, max_memory: int | None, *, gaussians: int, frames: int, threads: int
) -> EncodeMemory:
    """What the encode takes, and whether it reads the next frame ahead: not where there is too little memory for it.

    ``gaussians``: of a keyframe that is taken over; 0 without one. Raises UsageError where the encode does not fit into
    ``max_memory`` bytes at all; None is no limit.
    """
    if not (max_memory is None or hasattr(max_memory, "__index__")):
        raise UsageError(f"`max_memory` {max_memory!r}: give a whole number of bytes, or None")
    gaussians = gaussians or settings.keyframe.cap
    size = 0
    for reads_ahead in (True, False) if threads > 1 and frames > 1 else (False,):
        size = encode_memory(
            ingest, settings, gaussians=gaussians, frames=frames, threads=threads, reads_ahead=reads_ahead
        )
        if max_memory is None or size <= max_memory:
            return EncodeMemory(size, reads_ahead)
    largest = max((view.pinhole for view in ingest.views), key=lambda camera: camera.width * camera.height)
    raise UsageError(
        f"`max_memory`: {len(ingest.views)} cameras of up to {largest.width}x{largest.height} and {gaussians} "
        f"Gaussians may need {_in_mega(size)}, more than {_in_mega(max_memory)}; choose a smaller `scale` or allow more"
    )


def _in_mega(size: int | None) -> str:
    """As ``max_memory`` is written: whole numbers of 2**20 bytes, rounded up."""
    return f"{-(-(size or 0) // (1 << 20))}M"
