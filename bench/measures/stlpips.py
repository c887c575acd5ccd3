"""ST-LPIPS, when its package (``stlpips-pytorch``) and torch are installed: LPIPS that a shift by a pixel hardly moves.

Chosen: the package's weights alone, which lie in its wheel, all of them, and the network written out here. Its own code
takes torchvision, IPython and torchsummary, of which it declares none and uses next to nothing.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from .metrics import BytePicture

_PACKAGE, _WEIGHTS = "stlpips_pytorch", Path("weights", "vST0.0", "alex_shift_tolerant.pth")
_LAYERS = (("1.0", 2, "1.1"), ("2.5", 2, None), ("3.9", 1, None), ("4.11", 1, None), ("5.13", 1, None))
"""Of the package's AlexNet: the convolution, its padding, and the filter between it and its ReLU."""
_POOLED = {1: "2.4", 2: "3.8"}
"""Layers whose input is a maximum over 3x3 and then halved, by that filter."""
_LEAST_SIZE = 32
"""Pixels of a side: what the filters reflect at the borders has to be there."""


def st_lpips(seen: BytePicture, recorded: BytePicture) -> float | None:
    """ST-LPIPS on AlexNet, 0 for equal pictures; None without the package, without torch, or for tiny pictures.

    Source: Ghildyal and Liu 2022, the weights of their package.
    """
    weights = _weights()
    if weights is None or min(seen.shape[:2]) < _LEAST_SIZE:
        return None
    torch = importlib.import_module("torch")
    with torch.no_grad():
        layers = zip(_features(weights, seen), _features(weights, recorded), strict=True)
        return float(
            sum(
                torch.nn.functional.conv2d((a - b) ** 2, weights[f"lin{index}.model.1.weight"]).mean()
                for index, (a, b) in enumerate(layers)
            )
        )


def _features(weights: dict[str, Any], picture: BytePicture) -> Iterator[Any]:
    """After each layer, (1, C, H, W), every pixel's channels of length 1."""
    torch = importlib.import_module("torch")
    functional = torch.nn.functional
    planes = np.ascontiguousarray(picture.transpose(2, 0, 1)[None], np.float32) / np.float32(127.5) - np.float32(1)
    now = (torch.from_numpy(planes) - weights["scaling_layer.shift"]) / weights["scaling_layer.scale"]
    for index, (name, padding, between) in enumerate(_LAYERS):
        if index in _POOLED:
            now = _halved(functional.max_pool2d(now, 3, 1), weights[f"net.slice{_POOLED[index]}.filt"])
        convolution = f"net.slice{name}"
        now = functional.conv2d(now, weights[f"{convolution}.weight"], weights[f"{convolution}.bias"], padding=padding)
        if between is not None:
            now = _halved(now, weights[f"net.slice{between}.filt"])
        now = functional.relu(now)
        yield now / (now.square().sum(dim=1, keepdim=True).sqrt() + 1e-10)


def _halved(planes: Any, blur: Any) -> Any:
    functional = importlib.import_module("torch.nn.functional")
    padded = functional.pad(planes, (2, 2, 2, 2), mode="reflect")
    return functional.conv2d(padded, blur, stride=2, groups=planes.shape[1])


@lru_cache(maxsize=1)
def _weights() -> dict[str, Any] | None:
    """By their names in the package's file; the package itself is not loaded."""
    package = importlib.util.find_spec(_PACKAGE)
    folders = None if package is None else package.submodule_search_locations
    if not folders or importlib.util.find_spec("torch") is None:
        return None
    kept: dict[str, Any] = importlib.import_module("torch").load(
        Path(folders[0]) / _WEIGHTS, map_location="cpu", weights_only=True
    )
    return kept
