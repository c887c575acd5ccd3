"""What is compared: variants of the encoder as plain data, and the questions that sets of them answer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any

from decogs.encoder.analysis import EffectChoice
from decogs.encoder.coding.rate_control import with_quality
from decogs.encoder.job.switches import Switches, with_switches
from decogs.encoder.settings.encode import EncodeSettings
from decogs.encoder.settings.presets import preset
from decogs.formats.errors import UsageError


@dataclass(frozen=True)
class Times:
    """A changed setting that is so many times what it was: a number, or a group of numbers such as learning rates."""

    factor: float

    def __str__(self) -> str:
        return f"x {self.factor:g}"


@dataclass(frozen=True)
class Variant:
    """One way to encode.

    ``name``: letters, digits, '.', '_' and '-'; part of file names. ``settings``: what differs from the preset, by
    dotted path ("frame.masks.threshold"); values replace the setting, or are Times. ``preset`` None: the report's.
    ``method``, ``ablate``, ``selection``: as in `Switches`; ``quality``: as in `Targets`; ``effects``: None is all that
    the preset has. ``stride``: every so many frames. ``scale``: of the pictures it trains on, times the report's; it is
    measured at the report's all the same. ``timing``: one of `timing.TIMINGS`. ``frames``: only the first so many, or
    the last so many when negative. ``own_keyframe``: trains its own instead of starting from the one that all variants
    of a rig share. ``refined``: starts from the shared one on a lattice so many times as fine. ``seed`` None: the first
    of the report's.
    """

    name: str
    description: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    preset: str | None = None
    method: str | None = None
    ablate: tuple[str, ...] = ()
    selection: str | None = None
    quality: float | None = None
    effects: EffectChoice | None = None
    stride: int = 1
    scale: float = 1.0
    timing: str | None = None
    frames: int | None = None
    own_keyframe: bool = False
    refined: int = 1
    seed: int | None = None


@dataclass(frozen=True)
class Question:
    """A question put to every rig: its key (for ``--only``), heading, a sentence or two, and the rows that answer it.

    ``columns``: keys of ``tables.COLUMNS``, one table for each group of them. ``reference``: the row that the others
    are compared with; None: the preset's, if it is there.
    """

    key: str
    title: str
    about: str
    variants: tuple[Variant, ...]
    columns: tuple[tuple[str, ...], ...]
    reference: Variant | None = None


def settings_of(variant: Variant, report_preset: str) -> EncodeSettings:
    """Everything that a variant's encode does, whatever the rig; with a shared keyframe, what the preset says of it.

    Raises UsageError for a setting that does not exist, one of the keyframe that the variant does not train, and
    switches that exclude each other.
    """
    settings: Any = preset(variant.preset or report_preset)
    if not variant.own_keyframe:
        shared = preset(report_preset)
        settings = replace(settings, keyframe=shared.keyframe, lattice_scale=shared.lattice_scale)
    for path, value in variant.settings.items():
        if path.split(".")[0] in ("keyframe", "lattice_scale") and not variant.own_keyframe:
            raise UsageError(f"variant {variant.name}: changes {path} but shares the keyframe; set own_keyframe")
        try:
            settings = _changed(settings, path.split("."), value)
        except AttributeError:
            raise UsageError(f"variant {variant.name}: there is no setting {path!r}; see encoder/settings/") from None
    settings = with_switches(settings, Switches(variant.method, variant.ablate, variant.selection))
    if variant.quality is not None:
        if not variant.own_keyframe:
            raise UsageError(f"variant {variant.name}: changes quality but shares the keyframe; set own_keyframe")
        settings = with_quality(settings, variant.quality)
    assert isinstance(settings, EncodeSettings)
    return settings


def _changed(group: Any, path: list[str], value: Any) -> Any:
    """``group`` with the setting at ``path`` replaced."""
    if not path:
        return _times(group, value.factor) if isinstance(value, Times) else value
    name, *rest = path
    if not is_dataclass(group) or name not in {f.name for f in fields(group)}:
        raise AttributeError(name)
    changed = _changed(getattr(group, name), rest, value)
    return replace(group, **{name: changed})  # type: ignore[type-var]


def _times(group: Any, factor: float) -> Any:
    if is_dataclass(group) and not isinstance(group, type):
        return replace(group, **{f.name: _times(getattr(group, f.name), factor) for f in fields(group)})
    return type(group)(group * factor)
