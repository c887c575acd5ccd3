"""The layers that a header lists, the base first: what each has with all those below it (SPEC.md, "Layers").

A list that is out of its bounds counts as absent, so that a reader which knows no layers makes the same of any stream.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from ..packets.refinement import MAX_LAYERS
from ..scene.state import MAX_GAUSSIANS

if TYPE_CHECKING:
    from typing import TypeGuard

_MAX_BYTES_PER_FRAME = 1e9
_MAX_PSNR = 200.0


@dataclass(frozen=True)
class Layer:
    """``gaussians``: the most in any frame; ``bytes_per_frame``: mean, keyframes among them; both with the layers
    below. ``psnr``: dB of its pictures against those of all layers together; None of the last one, which is all."""

    gaussians: int
    bytes_per_frame: float
    psnr: float | None = None

    def as_document(self) -> dict[str, Any]:
        """The header's entry."""
        return {name: value for name, value in asdict(self).items() if value is not None}


def read_layers(document: object) -> tuple[Layer, ...]:
    """The layers in a header's member ``layers``; none where it, or any entry, is out of bounds."""
    if not isinstance(document, list) or not 2 <= len(document) <= MAX_LAYERS:
        return ()
    layers = [_layer(entry, is_last=number == len(document) - 1) for number, entry in enumerate(document)]
    return tuple(layer for layer in layers if layer is not None) if None not in layers else ()


def _layer(entry: object, *, is_last: bool) -> Layer | None:
    if not isinstance(entry, Mapping):
        return None
    gaussians, size, psnr = (entry.get(name) for name in ("gaussians", "bytes_per_frame", "psnr"))
    if type(gaussians) is not int or not 0 <= gaussians <= MAX_GAUSSIANS or not _is_within(size, _MAX_BYTES_PER_FRAME):
        return None
    if is_last:
        return Layer(gaussians, float(size)) if psnr is None else None
    return Layer(gaussians, float(size), float(psnr)) if _is_within(psnr, _MAX_PSNR) else None


def _is_within(value: Any, most: float) -> TypeGuard[float]:
    return type(value) in (int, float) and math.isfinite(value) and 0 <= value <= most
