"""Maps of errors: what is kept of them, and that runs carry those of their own cameras."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from decogs.bench.questions.variants import Variant
from decogs.bench.runs.error_maps import MOST_COLUMNS, packed, unpacked
from decogs.bench.runs.rig_bench import RigBench
from decogs.bench.runs.run import BenchOptions, read_run
from decogs.formats.errors import UsageError


def test_a_map_has_the_mean_square_of_its_picture(tmp_path: Path) -> None:
    errors = np.random.default_rng(0).random((240, 4 * MOST_COLUMNS)) ** 6
    (tmp_path / "maps.npz").write_bytes(packed([errors, errors[:10, :20]]))
    large, small = unpacked(tmp_path / "maps.npz")
    assert large.shape == (60, MOST_COLUMNS)
    assert np.mean((large / 255) ** 2) == pytest.approx(errors.mean(), rel=1e-3)
    np.testing.assert_allclose(small, 255 * np.sqrt(errors[:10, :20]), rtol=1e-3, atol=1e-6)
    assert (tmp_path / "maps.npz").stat().st_size < 32_000


@pytest.mark.usefixtures("short_presets")
def test_a_run_keeps_every_camera_s_map_and_psnr(three_frames: Path, tmp_path: Path) -> None:
    """Maps and figures are of the same errors: where frames are about alike, so are both PSNRs."""
    bench = RigBench(three_frames, tmp_path, BenchOptions(holdout=("cam02", "cam04"), preset="tiny", threads=1))
    variant = Variant("held", "held", frames=2)
    run = bench.run(variant)
    assert read_run(bench.file_of(run)) == run
    maps = bench.errors_of(run)
    assert list(maps) == ["cam02", "cam04"]
    for number, errors in enumerate(maps.values()):
        views = [frame.psnr_of_views[number] for frame in run.frames if frame.psnr_of_views is not None]
        mean_square = np.mean([10 ** (-psnr / 10) for psnr in views])
        assert np.mean((errors / 255) ** 2) == pytest.approx(mean_square, rel=1e-3)
    assert run.frames[0].psnr == pytest.approx(np.mean(run.frames[0].psnr_of_views or []))
    assert run.first_cpu_seconds is not None
    assert run.first_cpu_seconds > 0

    path = bench.file_of(run).with_suffix(".npz")
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(UsageError, match="is damaged"):
        bench.errors_of(run)
    path.unlink()
    assert bench.errors_of(run) == {}, "as of an older bench"
    assert bench.errors_of(replace(run, key="another")) == {}
