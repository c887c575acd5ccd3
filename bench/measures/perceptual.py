"""LPIPS, when its package and its weights are on this machine; nothing is ever downloaded.

The package (``lpips``, with torchvision) brings the weights of its last layers; those of the network below are a
file in torch's hub folder that torchvision would fetch on first use. It is looked for before the package is touched.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from .metrics import BytePicture

NOT_INSTALLED = "not installed"

Distance = Callable[[BytePicture, BytePicture], float]

_NETWORKS = (("alex", "AlexNet_Weights"), ("vgg", "VGG16_Weights"))
"""LPIPS's name of the network below, torchvision's name of its weights; the first one found is used."""


def installed_network() -> str | None:
    """The network ("alex" or "vgg") whose package and weights are all here; None when something is missing."""
    if any(importlib.util.find_spec(package) is None for package in ("lpips", "torchvision")):
        return None
    models = importlib.import_module("torchvision.models")
    hub: Any = importlib.import_module("torch.hub")
    for network, weights in _NETWORKS:
        file = str(getattr(models, weights).IMAGENET1K_V1.url).rsplit("/", 1)[-1]
        if (Path(hub.get_dir()) / "checkpoints" / file).is_file():
            return network
    return None


def perceptual_distance(network: str | None) -> Distance | None:
    """LPIPS v0.1 of two pictures; None for None. Source: Zhang 2018."""
    if network is None:
        return None
    torch = importlib.import_module("torch")
    model = importlib.import_module("lpips").LPIPS(net=network, verbose=False).eval()

    def planes(picture: BytePicture) -> Any:
        values = np.ascontiguousarray(picture.transpose(2, 0, 1)[None], np.float32)
        return torch.from_numpy(values / np.float32(127.5) - np.float32(1))

    def distance(seen: BytePicture, recorded: BytePicture) -> float:
        with torch.no_grad():
            return float(model(planes(seen), planes(recorded)))

    return distance
