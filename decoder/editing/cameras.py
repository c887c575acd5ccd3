"""The list of cameras of a header: some left out, others renamed, and all that the header says of them by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, replace

from decogs.codec.header.header import CONSTANT_EFFECTS, StreamHeader, constant_effects
from decogs.codec.packets.corrections import EFFECT_FIELDS, CorrectedCameras, Corrections
from decogs.formats.errors import UsageError


def check_names(operation: str, header: StreamHeader, names: Iterable[str]) -> None:
    """Raises UsageError for a name that no camera has."""
    names_of_cameras = [camera.name for camera in header.cameras]
    for name in names:
        if name not in names_of_cameras:
            listed = ", ".join(names_of_cameras[:40]) + (", ..." if len(names_of_cameras) > 40 else "")
            raise UsageError(f"{operation}: there is no camera {name!r} in this stream; it has {listed}")


def with_cameras(header: StreamHeader, name_of: Callable[[str], str | None]) -> StreamHeader:
    """The header with each camera under the name that ``name_of`` gives it; None leaves it out.

    Raises UsageError where none is left.
    """
    named = {camera.name: name for camera in header.cameras if (name := name_of(camera.name)) is not None}
    if not named:
        raise UsageError("a stream has at least one camera; leave one in it")
    corrected = CorrectedCameras(
        **{effect.name: _renamed(getattr(header.corrected, effect.name), named) for effect in fields(CorrectedCameras)}
    )
    colours = {named[name]: colour for name, colour in header.camera_colours.items() if name in named}
    presentation = header.presentation
    return replace(
        header,
        cameras=tuple(replace(camera, name=named[camera.name]) for camera in header.cameras if camera.name in named),
        held_out=_renamed(header.held_out, named),
        corrected=corrected,
        camera_colours=colours,
        effects=with_effects_of(header.effects, corrected, colours),
        presentation=replace(presentation, first_view=named.get(presentation.first_view or "")),
    )


def with_effects_of(effects: Iterable[str], corrected: CorrectedCameras, colours: Corrections) -> tuple[str, ...]:
    """The effects with those of cameras exactly where cameras have them (SPEC.md, "Header packet")."""
    has_effect = dict.fromkeys(CONSTANT_EFFECTS, False) | dict.fromkeys(constant_effects(colours), True)
    has_effect |= {
        effect: bool(getattr(corrected, effect)) or has_effect.get(effect, False) for effect in EFFECT_FIELDS
    }
    named = dict.fromkeys([*effects, *has_effect])
    return tuple(effect for effect in named if has_effect.get(effect, True))


def renamed_corrections(corrections: Corrections, name_of: Callable[[str], str | None]) -> Corrections:
    """A frame's corrections under the cameras' new names."""
    named: Mapping[str, str | None] = {name: name_of(name) for name in corrections}
    return {new: corrections[name] for name, new in named.items() if new is not None}


def _renamed(names: Iterable[str], named: Mapping[str, str]) -> tuple[str, ...]:
    return tuple(named[name] for name in names if name in named)
