"""Extension points: the example of docs/extending.md, installed as a package, encodes; what is missing is named."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from decogs.decoder.reading.stream import open_stream
from decogs.encoder import Switches
from decogs.encoder.change.selection import SELECTION_RULES, ViewEvidence, select
from decogs.encoder.job.switches import with_selection
from decogs.encoder.methods import FRAME_METHODS
from decogs.encoder.registry import Registry, anything, guarded
from decogs.encoder.settings.frame import SelectionSettings
from decogs.encoder.training.method import FrameMethod, TrainedFrame
from decogs.formats.errors import UsageError
from decogs.formats.splats import Splats, empty_splats, take_splats
from encode_rig import encode_rig as encode

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
    with pytest.raises(UsageError, match=r"^`method` recolour: there is no such method; choose from decogs, paper"):
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


class _Package:
    name = "decogs-example"


class _Point:
    """An entry point whose module cannot be imported."""

    value, dist = "broken_module:rule", None

    def __init__(self, name: str) -> None:
        self.name = name

    def load(self) -> Any:
        raise ImportError("no module named torch")


class _PackagesPoint(_Point):
    dist = _Package()  # type: ignore[assignment]

    def __init__(self, what: Any) -> None:
        super().__init__("broken")
        self._what = what

    def load(self) -> Any:
        return self._what


def installed_point(monkeypatch: pytest.MonkeyPatch, point: _Point) -> None:
    """An installed package has this one under every extension point."""
    monkeypatch.setattr("decogs.encoder.registry.entry_points", lambda group: [point])


def offered(monkeypatch: pytest.MonkeyPatch, what: Any) -> None:
    installed_point(monkeypatch, _PackagesPoint(what))


def test_what_cannot_be_used_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    installed_point(monkeypatch, _Point("broken"))
    registry = Registry("selection rule", "decogs.selection_rules", {"own": 1}, guarded(anything))
    assert registry.names() == ("own", "broken")
    assert registry.get("own") == 1
    with pytest.raises(UsageError, match="broken: the selection rule broken_module:rule cannot be imported: no module"):
        registry.get("broken")
    with pytest.raises(UsageError, match="other: there is no such selection rule; choose from own, broken"):
        registry.get("other")


def test_a_method_of_the_bench_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "decogs.bench.methods.threedgstream", None)
    with pytest.raises(UsageError, match=r"^3dgstream: this method comes with the bench, .*\[bench\]'$"):
        FRAME_METHODS.get("3dgstream")


def test_ours_cannot_be_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    installed_point(monkeypatch, _Point("weight"))
    assert SELECTION_RULES.names() == ("paper", "weight")
    assert SELECTION_RULES.get("weight").__name__ == "by_weight"  # type: ignore[attr-defined]


def raises(*given: Any, **named: Any) -> Any:
    raise ValueError("no\nsuch thing")


def returns(value: Any) -> Any:
    return lambda *given, **named: value


SAID = "broken: the {kind} broken_module:rule of the package decogs-example {problem}"


@pytest.mark.parametrize(
    ("rule", "problem"),
    [
        (returns(None), "returned None, not one bool for each Gaussian: bool (3,)"),
        (returns(np.zeros(2, bool)), "returned bool (2,), not one bool for each Gaussian: bool (3,)"),
        (returns(np.zeros((3, 1), bool)), "returned bool (3, 1), not one bool for each Gaussian: bool (3,)"),
        (returns(np.zeros(3)), "returned float64 (3,), not one bool for each Gaussian: bool (3,)"),
        (returns(np.zeros(3, np.int64)), "returned int64 (3,), not one bool for each Gaussian: bool (3,)"),
        (returns([True] * 3), "returned list, not one bool for each Gaussian: bool (3,)"),
        (lambda views: np.ones(3, bool), "raised TypeError: <lambda>() takes 1 positional argument but 2 were given"),
        (raises, "raised ValueError: no such thing"),
        (lambda *given: sys.exit(3), "raised SystemExit: 3"),
        (7, "is no function but int"),
        (None, "is no function but None"),
    ],
)
def test_what_a_rule_does_wrong_is_said_with_its_package(
    rule: Any, problem: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    offered(monkeypatch, rule)
    weight = np.ones(3, np.float32)
    view = ViewEvidence(weight, weight, lambda: np.ones(3, bool))
    with pytest.raises(UsageError) as told:
        select([view], SelectionSettings(rule="broken"))
    assert str(told.value) == SAID.format(kind="selection rule", problem=problem)


class _Trainer:
    def __init__(self, result: Any) -> None:
        self._result = result

    def train(self, frame: Any) -> Any:
        return self._result(frame) if callable(self._result) else self._result


def trained(frame: Any, **changes: Any) -> TrainedFrame:
    """A frame in which nothing changes, but for ``changes``."""
    none = np.zeros(0, np.int64)
    nothing = empty_splats(frame.scene.sh_degree)
    return replace(TrainedFrame(none, nothing, none, nothing), **changes)


ROWS = "that are not ascending from 0 to "


@pytest.mark.parametrize(
    ("method", "problem"),
    [
        (lambda context: None, "is no FrameMethod but function"),
        (None, "is no FrameMethod but None"),
        (FrameMethod(None), "is no function but None"),  # type: ignore[arg-type]
        (FrameMethod(raises), "raised ValueError: no such thing"),
        (FrameMethod(returns(None)), "returned None, which has no function `train`"),
        (None, "returned None, no TrainedFrame"),
        (lambda frame: np.zeros(3), "returned float64 (3,), no TrainedFrame"),
        (raises, "raised ValueError: no such thing"),
        (lambda frame: trained(frame, pace=0.5), "returned `pace` as float"),
        (lambda frame: trained(frame, kept=None), "returned `kept` as None, not as row numbers"),
        (lambda frame: trained(frame, kept=np.zeros(2)), "returned `kept` as float64 (2,), not as row numbers"),
        (lambda frame: trained(frame, removed=np.array([-1])), "returned `removed` with rows " + ROWS),
        (lambda frame: trained(frame, removed=np.array([1 << 40])), "returned `removed` with rows " + ROWS),
        (lambda frame: trained(frame, removed=np.array([2, 1])), "returned `removed` with rows " + ROWS),
        (lambda frame: trained(frame, removed=np.array([1, 1])), "returned `removed` with rows " + ROWS),
        (
            lambda frame: trained(frame, kept=np.array([1])),
            "returned `values` that are not finite Splats with a row for each",
        ),
        (
            lambda frame: trained(frame, values=None),
            "returned `values` that are not finite Splats with a row for each one",
        ),
        (
            lambda frame: trained(frame, added=[]),
            "returned `added` that are not finite Splats of the scene's SH degree",
        ),
        (
            lambda frame: trained(frame, added=empty_splats(3)),
            "returned `added` that are not finite Splats of the scene's SH",
        ),
        (lambda frame: trained(frame, added=_splats(2, np.nan)), "returned `added` that are not finite Splats of the"),
        (
            lambda frame: trained(frame, sensitivity=1.0),
            "returned `sensitivity` that is not finite Splats with a row for",
        ),
        (
            lambda frame: trained(
                frame, kept=np.array([1]), values=take_splats(frame.scene, np.array([1])), removed=np.array([1])
            ),
            "returned rows as both `kept` and `removed`",
        ),
    ],
)
def test_what_a_method_does_wrong_is_said_with_its_package(
    method: Any, problem: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    in_training = problem.startswith(("returned `", "returned rows")) or "TrainedFrame" in problem or method is raises
    offered(monkeypatch, FrameMethod(lambda context: _Trainer(method)) if in_training else method)
    frame = SimpleNamespace(scene=_splats(4))
    with pytest.raises(UsageError) as told:
        FRAME_METHODS.get("broken").trainer(None).train(frame)  # type: ignore[arg-type]
    assert str(told.value).startswith(SAID.format(kind="method", problem=problem))


def test_a_method_that_is_right_is_not_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    offered(monkeypatch, FrameMethod(lambda context: _Trainer(trained)))
    frame = SimpleNamespace(scene=_splats(4))
    assert len(FRAME_METHODS.get("broken").trainer(None).train(frame).kept) == 0  # type: ignore[arg-type]


def _splats(count: int, value: float = 0.0) -> Splats:
    shapes = ((count, 3), (count, 3), (count, 4), (count,), (count, 4, 3))
    return Splats(*(np.full(shape, value, np.float32) for shape in shapes))


def test_a_rule_of_a_package_is_a_setting_as_ours_are(
    installed: Path, tiny_settings: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(installed)
    assert with_selection(tiny_settings, "majority").frame.selection.rule == "majority"
