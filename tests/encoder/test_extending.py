"""Extension points: the example of docs/extending.md, installed as a package, encodes; what is missing is named."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decogs.decoder.stream import open_stream
from decogs.encoder import Switches, encode
from decogs.encoder.change.selection import SELECTION_RULES, ViewEvidence, select
from decogs.encoder.registry import Registry, anything, guarded
from decogs.encoder.settings.frame import SelectionSettings
from decogs.encoder.switches import with_selection
from decogs.encoder.training.methods import FRAME_METHODS
from decogs.formats.errors import UsageError

DOCUMENT = Path(__file__).parents[2] / "docs" / "extending.md"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where pip has put the package that the document shows."""
    project, target = (tmp_path_factory.mktemp(name) for name in ("decogs-example", "installed"))
    shown = re.findall(r"```(?:python|toml)\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)
    for name, text in zip(("decogs_majority.py", "decogs_recolour.py", "pyproject.toml"), shown, strict=True):
        (project / name).write_text(text)
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*pip, "--target", str(target), str(project)], check=True)
    return target


def test_the_documents_rule_encodes_when_it_is_installed(
    installed: Path, moving: Any, moving_rig: Path, tiny_rig: Any, tiny_settings: Any, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    given = {
        "settings": tiny_settings,
        "holdout": [tiny_rig.held_out],
        "keyframe": moving.path,
        "switches": Switches(selection="majority"),
    }
    with pytest.raises(
        UsageError, match=r"^`selection` majority: there is no such selection rule; choose from paper, w"
    ):
        encode(moving_rig, tmp_path / "x.dgs", **given)
    monkeypatch.syspath_prepend(installed)
    report = encode(moving_rig, tmp_path / "x.dgs", **given)
    with open_stream(tmp_path / "x.dgs") as stream:
        assert stream.header.settings["frame"]["selection"]["rule"] == "majority"
        assert len(list(stream.frames())) == len(report.frames)
    assert 0 < report.frames[1].selected < 0.5
    assert (tmp_path / "x.dgs").read_bytes() != moving.data, "it chooses otherwise than the default"


def test_the_documents_method_encodes_when_it_is_installed(
    installed: Path, moving: Any, moving_rig: Path, tiny_rig: Any, tiny_settings: Any, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    given = {
        "settings": tiny_settings,
        "holdout": [tiny_rig.held_out],
        "keyframe": moving.path,
        "switches": Switches("recolour"),
    }
    with pytest.raises(UsageError, match=r"^`method` recolour: there is no such method; choose from decogs, 3dgs"):
        encode(moving_rig, tmp_path / "x.dgs", **given)
    monkeypatch.syspath_prepend(installed)
    report = encode(moving_rig, tmp_path / "x.dgs", **given)
    assert [frame.kind for frame in report.frames] == [frame.kind for frame in moving.report.frames]
    with open_stream(tmp_path / "x.dgs") as stream:
        assert stream.header.settings["method"] == "recolour"
        first, second, *_ = stream.frames()
    rows = np.isin(first.state.ids, second.state.ids)
    assert rows.all(), "it removes nothing"
    np.testing.assert_array_equal(first.splats.means, second.splats.means[: len(first.splats)])
    assert (first.splats.sh != second.splats.sh[: len(first.splats)]).any()
    assert report.frames[1].training_psnr > moving.report.frames[1].training_psnr - 6


@pytest.fixture(autouse=True)
def nothing_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each test finds packages anew."""
    for registry in (SELECTION_RULES, FRAME_METHODS):
        monkeypatch.setattr(registry, "_loaded", {})


class _Point:
    """An entry point whose module cannot be imported."""

    name, value, dist = "broken", "broken_module:rule", None

    def load(self) -> Any:
        raise ImportError("no module named torch")


def test_what_cannot_be_used_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("decogs.encoder.registry.entry_points", lambda group: [_Point()])
    registry = Registry("selection rule", "decogs.selection_rules", {"own": 1}, guarded(anything))
    assert registry.names() == ("own", "broken")
    assert registry.get("own") == 1
    with pytest.raises(UsageError, match="broken: the selection rule broken_module:rule cannot be imported: no module"):
        registry.get("broken")
    with pytest.raises(UsageError, match="other: there is no such selection rule; choose from own, broken"):
        registry.get("other")


def test_ours_cannot_be_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    point = _Point()
    point.name = "weight"
    monkeypatch.setattr("decogs.encoder.registry.entry_points", lambda group: [point])
    assert SELECTION_RULES.names() == ("paper", "weight")
    assert SELECTION_RULES.get("weight").__name__ == "by_weight"  # type: ignore[attr-defined]


def test_a_rule_that_returns_something_else_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    point = _Point()
    monkeypatch.setattr(point, "load", lambda: lambda views, settings: np.zeros(2), raising=False)
    monkeypatch.setattr("decogs.encoder.registry.entry_points", lambda group: [point])
    weight = np.ones(3, np.float32)
    view = ViewEvidence(weight, weight, lambda: np.ones(3, bool))
    with pytest.raises(
        UsageError, match=r"broken: the selection rule broken_module:rule returned float64 \(2,\), not one"
    ):
        select([view], SelectionSettings(rule="broken"))


def test_a_rule_of_a_package_is_a_setting_as_ours_are(
    installed: Path, tiny_settings: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(installed)
    assert with_selection(tiny_settings, "majority").frame.selection.rule == "majority"
