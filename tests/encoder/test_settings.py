"""Settings are checked where they are made: every field has its range, and a wrong value is named."""

from __future__ import annotations

import inspect
import json
import math
import pkgutil
import re
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import pytest

import decogs.encoder.settings as settings_package
from decogs.codec.packets.corrections import LampWave
from decogs.encoder import PRESETS, CorrectionSettings, EncodeSettings, Switches, Targets
from decogs.encoder.job.switches import check_together
from decogs.encoder.settings.checked import Checked, OneOf, Within
from decogs.encoder.settings.effects import EFFECT_NAMES
from decogs.encoder.settings.frame import FrameSettings
from decogs.encoder.settings.optimiser import LearningRates
from decogs.encoder.settings.reading import read_settings
from decogs.formats.errors import UsageError
from encode_rig import encode_rig as encode


def classes() -> list[type]:
    """Every dataclass that the settings' modules define, but for the ranges themselves and what the header has, too."""
    modules = [
        import_module(f"decogs.encoder.settings.{m.name}") for m in pkgutil.iter_modules(settings_package.__path__)
    ]
    found = {
        kind for module in modules for kind in vars(module).values() if isinstance(kind, type) and is_dataclass(kind)
    }
    return sorted(found - {Within, OneOf, LampWave}, key=lambda kind: kind.__name__)


def made(kind: type) -> Any:
    return LearningRates(1, 1, 1, 1, 1, 1) if kind is LearningRates else kind()


FIELDS = [(kind, field.name) for kind in classes() for field in fields(kind)]
BESIDES = [math.nan, math.inf, -math.inf, 1e300, 10**400, -(10**5000), "1", b"1", [1], {}, object()]
"""What no field takes. Python prints no integer of 5000 digits."""


def hint_of(kind: type, name: str) -> tuple[Any, bool]:
    """Type and range of a field, and whether it may be None."""
    hint = get_type_hints(kind, include_extras=True)[name]
    given = [each for each in get_args(hint) if each is not type(None)]
    optional = type(None) in get_args(hint)
    return (given[0] if optional else hint), optional


def wrong_values(kind: type, name: str) -> Iterator[object]:
    hint, optional = hint_of(kind, name)
    plain, limits = get_args(hint)[:2] if get_origin(hint) is Annotated else (hint, None)
    yield from (
        value
        for value in BESIDES
        if not (plain is str and value == "1") and not (value == {} and get_origin(plain) is Mapping)
    )
    if not optional:
        yield None
    if plain in (int, float):
        yield True
        yield from (limits.high * 2 + 1, limits.low - 1)
    if plain is int:
        yield 2.0
    if plain is bool:
        yield from (0, 1, "yes")
    if plain is str:
        yield ""
    if get_origin(plain) is tuple:
        yield from ("cam01", ["cam01"], (1,), ("",), (EFFECT_NAMES[0],) * 2, ("focus",) * 2)
    if get_origin(plain) is Mapping:
        yield from ({"cam01": math.nan}, {"cam01": 1e3}, {1: 0.1}, {"": 0.1}, {"cam01": None}, ("cam01",))


def test_there_are_settings() -> None:
    """The walk below sees all that an encode can be set to."""
    assert {EncodeSettings, FrameSettings, CorrectionSettings} <= set(classes())
    assert 55 < len(FIELDS) <= 73, "a new field is one that a preset, an option or an effect varies"


@pytest.mark.parametrize(("kind", "name"), FIELDS, ids=[f"{kind.__name__}.{name}" for kind, name in FIELDS])
def test_every_field_has_a_range_and_keeps_to_it(kind: type, name: str) -> None:
    assert issubclass(kind, Checked)
    hint, _ = hint_of(kind, name)
    assert hint not in (int, float), "a number has a range"
    for value in wrong_values(kind, name):
        with pytest.raises(UsageError, match=rf"^`{name}` .* \({kind.__name__}\)$"):
            replace(made(kind), **{name: value})


@pytest.mark.parametrize("kind", classes(), ids=lambda kind: kind.__name__)
def test_every_field_says_on_its_line_what_it_is(kind: type) -> None:
    """Unit and which way is slower stand beside type, range and default; settings within settings say it themselves."""
    lines = inspect.getsource(kind).splitlines()
    for field in fields(kind):
        if not re.match(r"\w+Settings|FocusWeights", str(field.type)):
            (line,) = [line for line in lines if line.startswith(f"    {field.name}: ")]
            assert re.search(r"  # \S+", line), f"{kind.__name__}.{field.name}"


@pytest.mark.parametrize("name", [field.name for field in fields(Targets)])
@pytest.mark.parametrize("value", ["50", True, b"1", (1,), {}])
def test_targets_are_numbers(name: str, value: object) -> None:
    """Their ranges are checked when the settings are made of them."""
    if not (name == "lossless" and value is True):
        with pytest.raises(UsageError, match=rf"^`{name}` .* \(Targets\)$"):
            Targets(**{name: value})  # type: ignore[arg-type]


@pytest.mark.parametrize("given", [{"ablate": "focus"}, {"ablate": [1]}, {"method": 3}, {"selection": ["paper"]}])
def test_switches_are_names(given: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match=rf"^`{next(iter(given))}` .* \(Switches\)$"):
        Switches(**given)


def test_the_bounds_themselves_are_taken() -> None:
    for given in ({"warm_start": 0}, {"warm_start": 1.0}, {"beta1": 0}):
        replace(FrameSettings(), **given)  # type: ignore[arg-type]
    with pytest.raises(
        UsageError, match=r"^`joint_iterations` -1: give a whole number from 0 to 1000000 \(FrameSettings"
    ):
        FrameSettings(joint_iterations=-1)


@pytest.mark.parametrize("name", PRESETS)
def test_settings_are_read_back_from_a_header_and_checked_there(name: str) -> None:
    document = json.loads(json.dumps(PRESETS[name].as_document()))
    assert read_settings(document) == PRESETS[name]
    document["frame"]["joint_iterations"] = -1
    with pytest.raises(UsageError, match=r"^`joint_iterations` -1: "):
        read_settings(document)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda: EncodeSettings(closed=True), "`closed`: say how many frames a segment has, with `segment`"),
        (lambda: EncodeSettings(closed=True, segment=3, time_budget=1.0), "`closed`: `time_budget` carries time"),
        (
            lambda: FrameSettings(ablated=("focsu",)),
            r"`ablated` \('focsu',\): give a tuple of names from focus, gate",
        ),
        (lambda: EncodeSettings(effects=("motoin",)), r"`effects` \('motoin',\): give a tuple of names from motion, "),
    ],
)
def test_fields_that_exclude_each_other_and_names_are_refused(change: Any, message: str) -> None:
    with pytest.raises(UsageError, match=f"^{message}"):
        change()


STANDARD, DENSE = PRESETS["standard"], EncodeSettings(method="3dgstream")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (replace(STANDARD, method="4dgs"), "`method` 4dgs: there is no such method; choose from decogs, paper,"),
        (
            replace(STANDARD, frame=replace(STANDARD.frame, selection=replace(STANDARD.frame.selection, rule="x"))),
            "`rule` x: there is no such selection rule; choose from paper, weight",
        ),
        (
            replace(DENSE, target_psnr=30.0),
            "`target_psnr`: `method` 3dgstream trains a fixed number of steps; drop one",
        ),
        (replace(DENSE, time_budget=1.0), "`time_budget`: `method` 3dgstream trains a fixed number of steps; drop one"),
        (replace(DENSE, frame_budget=1e4), "`bytes_per_frame` 10000: `method` 3dgstream codes every change; drop one"),
        (
            replace(PRESETS["paper"], frame_budget=1e4),
            "`bytes_per_frame` 10000: these settings code every change; choose",
        ),
        (
            replace(DENSE, frame=replace(DENSE.frame, ablated=("focus",))),
            "`ablate` focus: `method` 3dgstream has no such part; drop one of the two",
        ),
    ],
)
def test_names_of_what_is_not_installed_are_refused_before_an_encode(settings: Any, message: str) -> None:
    with pytest.raises(UsageError, match=f"^{message}"):
        check_together(settings)


@pytest.mark.parametrize(
    "given", [{"settings": 3}, {"settings": None}, {"seed": 1.5}, {"seed": "1"}, {"effects": ("motion",)}]
)
def test_an_encode_refuses_other_kinds_of_values(given: dict[str, Any], moving_rig: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=rf"^`{next(iter(given))}` "):
        encode(moving_rig, tmp_path / "x.dgs", **given)
    assert not list(tmp_path.iterdir())
