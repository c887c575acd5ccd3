"""ST-LPIPS: none without its weights, and with them the figures of its package's own code."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from decogs.bench.measures import stlpips
from decogs.bench.measures.quality import METRICS
from decogs.bench.measures.stlpips import st_lpips

rows, columns = np.mgrid[:48, :64]
PICTURE = np.stack([4 * columns, 5 * rows, (7 * columns * rows) % 256], axis=2).astype(np.uint8)


@pytest.fixture(autouse=True)
def _anew() -> Iterator[None]:
    stlpips._weights.cache_clear()
    yield
    stlpips._weights.cache_clear()


def test_without_its_package_there_is_no_figure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stlpips.importlib.util, "find_spec", lambda name: None)
    assert st_lpips(PICTURE, 255 - PICTURE) is None
    assert METRICS["st_lpips"].nothing == "not installed"


def test_of_weights_at_random_only_likes_are_alike(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in of the package: its file of weights and nothing else."""
    torch = pytest.importorskip("torch")
    torch.manual_seed(0)
    widths = (3, 64, 192, 384, 256, 256)
    weights = {"scaling_layer.shift": torch.zeros(1, 3, 1, 1), "scaling_layer.scale": torch.ones(1, 3, 1, 1)}
    for index, (name, size) in enumerate((("1.0", 11), ("2.5", 5), ("3.9", 3), ("4.11", 3), ("5.13", 3))):
        weights[f"net.slice{name}.weight"] = torch.randn(widths[index + 1], widths[index], size, size) / 30
        weights[f"net.slice{name}.bias"] = torch.zeros(widths[index + 1])
        weights[f"lin{index}.model.1.weight"] = torch.rand(1, widths[index + 1], 1, 1)
    for name, width in (("1.1", 64), ("2.4", 64), ("3.8", 192)):
        weights[f"net.slice{name}.filt"] = torch.full((width, 1, 3, 3), 1 / 9)
    file = tmp_path / "stlpips_pytorch" / "weights" / "vST0.0" / "alex_shift_tolerant.pth"
    file.parent.mkdir(parents=True)
    (tmp_path / "stlpips_pytorch" / "__init__.py").write_text("raise ImportError('torchvision')")
    torch.save(weights, file)
    monkeypatch.syspath_prepend(str(tmp_path))
    assert st_lpips(PICTURE, PICTURE) == 0
    near, far = st_lpips(PICTURE ^ 3, PICTURE), st_lpips(255 - PICTURE, PICTURE)
    assert near is not None and far is not None  # noqa: PT018
    assert 0 < near < far
    assert st_lpips(PICTURE[:31], PICTURE[:31]) is None, "too small for the filters"


def test_its_figures_are_those_of_its_own_package() -> None:
    """Of `stlpips-pytorch` 0.0.2, `LPIPS(net="alex", variant="shift_tolerant")`."""
    pytest.importorskip("torch")
    if stlpips._weights() is None:
        pytest.skip("stlpips-pytorch is not installed")
    assert st_lpips(np.roll(PICTURE, 1, axis=1), PICTURE) == pytest.approx(0.011456648, rel=1e-4)
    assert st_lpips(255 - PICTURE, PICTURE) == pytest.approx(0.692117572, rel=1e-4)
