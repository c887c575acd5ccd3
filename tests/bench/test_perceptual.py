"""LPIPS is found only when package and weights are here, and nothing is fetched to find out."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from decogs.bench.measures.perceptual import installed_network, perceptual_distance

TORCHVISION = """
class _Weights:
    def __init__(self, url):
        self.url = url

class AlexNet_Weights:
    IMAGENET1K_V1 = _Weights("https://example.org/models/alexnet-1234.pth")

class VGG16_Weights:
    IMAGENET1K_V1 = _Weights("https://example.org/models/vgg16-5678.pth")
"""

LPIPS = """
import torch

class LPIPS(torch.nn.Module):
    def __init__(self, net, verbose):
        super().__init__()
        self.net = net

    def forward(self, a, b):
        assert a.shape == b.shape == (1, 3, 4, 5)
        assert float(a.min()) == -1 and float(a.max()) == 1
        return (a - b).abs().mean().reshape(1, 1, 1, 1)
"""


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Stand-ins for lpips and torchvision, and an empty hub folder, which is returned."""
    site = tmp_path / "site"
    (site / "torchvision").mkdir(parents=True)
    (site / "torchvision" / "__init__.py").write_text("")
    (site / "torchvision" / "models.py").write_text(TORCHVISION)
    (site / "lpips.py").write_text(LPIPS)
    hub = tmp_path / "hub"
    (hub / "checkpoints").mkdir(parents=True)
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.setattr(importlib.import_module("torch.hub"), "get_dir", lambda: str(hub))
    for name in ("lpips", "torchvision", "torchvision.models"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return hub


def test_packages_without_weights_do_not_count(packages: Path) -> None:
    assert installed_network() is None
    (packages / "checkpoints" / "alexnet-of-another-release.pth").touch()
    assert installed_network() is None


def test_the_network_whose_weights_are_there(packages: Path) -> None:
    (packages / "checkpoints" / "vgg16-5678.pth").touch()
    assert installed_network() == "vgg"
    (packages / "checkpoints" / "alexnet-1234.pth").touch()
    assert installed_network() == "alex"


@pytest.mark.parametrize("package", ["lpips", "torchvision"])
def test_weights_without_the_package_do_not_count(
    package: str, packages: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (packages / "checkpoints" / "alexnet-1234.pth").touch()
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == package else find(name))
    assert installed_network() is None


def test_pictures_go_in_as_lpips_takes_them(packages: Path) -> None:
    """Planar, -1 to 1."""
    distance = perceptual_distance("alex")
    assert distance is not None
    seen = np.zeros((4, 5, 3), np.uint8)
    recorded = np.zeros((4, 5, 3), np.uint8)
    seen[0, 0], recorded[0, 0] = 255, 255
    recorded[0, 1], seen[0, 1] = 255, 0
    assert distance(seen, recorded) == pytest.approx(2 / 20)


def test_without_a_network_there_is_no_distance() -> None:
    assert perceptual_distance(None) is None
