"""What decoding may take of the computer's memory: the stream, its scene, and the pictures of it, within one limit."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from contextlib import contextmanager

from decogs.formats.cameras import Camera, is_wide
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.stream.container import MAX_PAYLOAD

DEFAULT_MAX_MEMORY = 4 << 30
"""What decoding may take by default, in bytes, beyond the program itself."""

MAX_PICTURE_PIXELS = 1 << 26
"""No larger picture is rendered (8192 x 8192): a few header bytes must not be able to claim all memory."""

_PAYLOAD_DIVISOR = 6
"""A payload may take this fraction of the memory: all that a delta can say of the scene that fits, uncompressed."""

_COPIES = 15
"""A Gaussian may take this many times its bytes in a state: two states and the first keyframe's, their floats,
and what is there in passing.

The largest files that pass take up to 80 % of the limit (``tests/decoder/reading/test_damage.py``)."""

_FRAME_DIVISOR, _FRAME_BYTES = 16, 256
"""The fraction of the memory for knowing where frames lie, and what one costs: 240 bytes, the index packet included."""

_RENDERED_BYTES, _WRITTEN_BYTES, _LENS_BYTES = 36, 60, 64
"""What a pixel takes: of the pinhole picture while it is rendered (colours and depth, planar and interleaved), of the
view's own while it is converted and written, and of a view with a lens besides (its tables, and what makes them)."""

_FACES_BYTES = 56
"""What a pixel of a very wide pinhole picture takes besides: its faces' pictures and tables, and what makes them."""

_LAYER_BYTES = 50
"""What a pixel takes besides while layers of it are rendered and kept: 130 in all were measured for an EXR."""

_COPIES_SHOWN, _PROJECTED_BYTES = 8, 160
"""While a picture is rendered a Gaussian takes this many times its bytes in a state, and so many in the renderer."""

_PAIR_BYTES = 64
"""What the renderer takes for a Gaussian in one of the 16x16 tiles that it meets: 36 for a scene that is placed, the
rest where all of it changes."""


def payload_within(max_memory: int) -> int:
    """The largest payload that is read, in bytes."""
    return min(MAX_PAYLOAD, max_memory // _PAYLOAD_DIVISOR)


def frames_within(max_memory: int) -> int:
    """How many frames a stream may have whose places are all known at once."""
    return max_memory // _FRAME_DIVISOR // _FRAME_BYTES


def gaussians_within(max_memory: int, coefficients: int, max_gaussians: int) -> int:
    """The Gaussians that fit, with ``coefficients`` of SH for each colour."""
    return min(max_gaussians, max_memory // (_COPIES * _state_bytes(coefficients)))


def check_picture(
    camera: Camera, max_memory: int, *, lens: bool, rendered: Camera | None = None, layers: bool = False
) -> None:
    """Raises UsageError when the picture of ``camera`` does not fit, made from that of ``rendered``, if that is known.

    ``lens``: whether the way from there needs tables. ``layers``: whether motion and the like come with it.
    """
    beside = _LAYER_BYTES * camera.width * camera.height * layers
    if _picture_bytes(camera, lens, rendered or camera) + beside > max_memory:
        raise UsageError(
            f"camera {camera.name!r}: a picture of {camera.width}x{camera.height} needs more than the memory allowed; "
            "choose a smaller scale or more memory (`max_memory`)"
        )


def pairs_within(
    max_memory: int, gaussians: int, coefficients: int, camera: Camera, rendered: Camera, lens: bool
) -> int:
    """How many pairs of a 16x16 tile and a Gaussian that meet may be listed for this picture of a scene."""
    scene = gaussians * (_COPIES_SHOWN * _state_bytes(coefficients) + _PROJECTED_BYTES)
    return max(0, max_memory - scene - _picture_bytes(camera, lens, rendered)) // _PAIR_BYTES


@contextmanager
def limits_explained(max_memory: int, limits: Collection[int]) -> Iterator[None]:
    """Says how to raise a limit that a stream is above, where it is one of ``limits``, which follow from the memory."""
    try:
        yield
    except StreamError as error:
        above = re.search(r"limit of (\d+)", str(error))
        if above is not None and int(above[1]) in limits:
            error.args = (f"{error}; allow more memory than {max_memory} bytes (`max_memory`)",)
        raise


def _picture_bytes(camera: Camera, lens: bool, rendered: Camera) -> int:
    own = camera.width * camera.height * (_WRITTEN_BYTES + _LENS_BYTES * lens)
    return own + rendered.width * rendered.height * (_RENDERED_BYTES + _FACES_BYTES * is_wide(rendered))


def _state_bytes(coefficients: int) -> int:
    """A Gaussian has 11 + 3 K numbers of up to 4 bytes, an id and a hash of 8."""
    return 4 * (11 + 3 * coefficients) + 16
