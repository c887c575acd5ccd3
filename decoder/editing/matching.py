"""Another take in the terms of a first one: its lattice, SH degree and cameras, so that one header describes both."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from itertools import count

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.corrections import CorrectedCameras
from decogs.codec.packets.keyframes import new_state
from decogs.codec.packets.sound import SoundTrack
from decogs.codec.scene.lattice import Lattice, dequantise, quantise
from decogs.codec.scene.state import ARRAYS, Attributes, State, all_rows
from decogs.formats.cameras import Camera
from decogs.formats.errors import TrainingError, UsageError
from decogs.formats.frames.rates import is_same_rate
from decogs.formats.geometry.similarity import NO_CHANGE, Similarity, transformed_camera, transformed_splats
from decogs.formats.splats import Splats

from .cameras import renamed_corrections, with_cameras, with_effects_of
from .take import Take


@dataclass(frozen=True, eq=False)
class Matched:
    """Two takes under one header, and a line that says what that cost the ``second``, "" for nothing."""

    header: StreamHeader
    first: Take
    second: Take
    cost: str


def matched(operation: str, first: Take, second: Take) -> Matched:
    """Both takes under the first one's header, with the cameras of both, in the world in which each is shown.

    Values of the second are rounded to the first one's lattice where it has another, or another transform. A camera
    that both have is one; a name that means two cameras gets a number in the second. Where one has no layers, neither
    has any. Raises UsageError where a subject without a background meets a whole scene, and where frame rates differ.
    """
    in_layers = bool(first.header.layers) and bool(second.header.layers)
    lost = "" if in_layers or not (first.header.layers or second.header.layers) else "both without layers"
    if not in_layers:
        first, second = first.without_layers(), second.without_layers()
    one, other = first.header, second.header
    if one.subject != other.subject:
        raise UsageError(
            f"{operation}: one is a subject without a background, the other a whole scene; they do not go together"
        )
    if one.fps is not None and other.fps is not None and not is_same_rate(one.fps, other.fps):
        raise UsageError(
            f"{operation}: one has {one.fps:.7g} frames a second, the other {other.fps:.7g}; `retime` one first"
        )
    degree = max(one.sh_degree, other.sh_degree)
    similarity = NO_CHANGE
    if one.presentation.transform != other.presentation.transform:
        similarity = one.presentation.similarity.inverse.after(other.presentation.similarity)
        other = replace(other, cameras=tuple(transformed_camera(camera, similarity) for camera in other.cameras))
    header = _common(one, other := _with_own_names(one, other))
    names = {was.name: now.name for was, now in zip(second.header.cameras, other.cameras, strict=True)}
    taken = second.each(lambda frame: replace(frame, corrections=renamed_corrections(frame.corrections, names.get)))
    changed = _rounded(other.lattice, one.lattice)
    if not similarity.is_identity:
        heard = tuple(_moved(track, similarity) for track in taken.header.sound)
        taken = replace(taken, header=replace(taken.header, sound=heard))
        taken = taken.each_scene(lambda state: _transformed(state, other.lattice, one.lattice, similarity))
    elif changed:
        taken = taken.each_scene(lambda state: requantised(state, other.lattice, one.lattice))
    sources = (*first.sources, *second.sources)
    return Matched(
        replace(header, sh_degree=degree),
        replace(_of_degree(first, degree), sources=sources),
        _of_degree(taken, degree),
        ", ".join(filter(None, (_cost(changed, similarity), lost))),
    )


def _moved(track: SoundTrack, similarity: Similarity) -> SoundTrack:
    """A track whose sound comes from where this takes it."""
    if track.position is None:
        return track
    x, y, z = (similarity.matrix @ (*track.position, 1.0))[:3].tolist()
    return replace(track, position=(x, y, z))


def requantised(state: State, was: Lattice, lattice: Lattice) -> State:
    """A scene's nearest points on another lattice; values whose steps are the same keep their integers.

    Each row by itself, so that one which does not change goes on not changing.
    """
    old = all_rows(state)
    sh = old.sh * np.float64(was.sh_rest)
    sh[:, :1] = old.sh[:, :1] * np.float64(was.sh_dc)
    values = Splats(
        old.means * np.asarray(was.means) + np.asarray(was.origin),
        old.log_scales * np.float64(was.log_scales),
        old.quaternions * np.float64(was.quaternions),
        old.opacity_logits * np.float64(was.opacity_logits),
        sh,
    )
    points = _on(lattice, values)
    other = _rounded(was, lattice)
    numbers = Attributes(**{name: getattr(points if name in other else old, name) for name in ARRAYS})
    return new_state(numbers, state.frame, ids=state.ids, next_id=state.next_id)


def _transformed(state: State, was: Lattice, lattice: Lattice, similarity: Similarity) -> State:
    """The nearest points of a scene that was brought elsewhere."""
    points = _on(lattice, transformed_splats(dequantise(state, was), similarity))
    return new_state(points, state.frame, ids=state.ids, next_id=state.next_id)


def _on(lattice: Lattice, values: Splats) -> Attributes:
    """The nearest lattice points. Raises UsageError where its integers do not reach."""
    try:
        return quantise(values, lattice)
    except TrainingError as error:
        raise UsageError(f"a scene does not fit the lattice of the first stream ({error}); `crop` it before") from None


def _cost(changed: list[str], similarity: Similarity) -> str:
    if not similarity.is_identity:
        return "brought to where its transform says, rounded to the lattice of the first"
    return f"{', '.join(changed)} rounded to the lattice of the first" if changed else ""


def _rounded(was: Lattice, lattice: Lattice) -> list[str]:
    """The arrays whose values lie elsewhere on the other lattice."""
    steps = {
        "means": ("origin", "means"),
        "log_scales": ("log_scales",),
        "quaternions": ("quaternions",),
        "opacity_logits": ("opacity_logits",),
        "sh": ("sh_dc", "sh_rest"),
    }
    return [name for name, of in steps.items() if any(getattr(was, step) != getattr(lattice, step) for step in of)]


def _of_degree(take: Take, degree: int) -> Take:
    """The take with coefficients of zero up to a degree."""
    missing = (degree + 1) ** 2 - take.header.coefficients
    if not missing:
        return take

    def padded(state: State) -> State:
        old = all_rows(state)
        sh = np.concatenate([old.sh, np.zeros((len(state), missing, 3), np.int32)], axis=1)
        return new_state(replace(old, sh=sh), state.frame, ids=state.ids, next_id=state.next_id)

    return take.each_scene(padded)


def _common(one: StreamHeader, other: StreamHeader) -> StreamHeader:
    """The first header with the cameras of both, which by now have the same name only if they are the same."""
    shared = {camera.name for camera in one.cameras}
    corrected = CorrectedCameras(
        **{
            effect.name: tuple(
                dict.fromkeys((*getattr(one.corrected, effect.name), *getattr(other.corrected, effect.name)))
            )
            for effect in fields(CorrectedCameras)
        }
    )
    colours = {**other.camera_colours, **one.camera_colours}
    return replace(
        one,
        fps=one.fps or other.fps,
        cameras=(*one.cameras, *(camera for camera in other.cameras if camera.name not in shared)),
        held_out=tuple(dict.fromkeys((*one.held_out, *other.held_out))),
        corrected=corrected,
        camera_colours=colours,
        effects=with_effects_of((*one.effects, *other.effects), corrected, colours),
        licence=_both(one.licence, other.licence),
        source_text=_both(one.source_text, other.source_text),
    )


def _both(one: str, other: str) -> str:
    return one if other in (one, "") else f"{one}; {other}" if one else other


def _with_own_names(one: StreamHeader, other: StreamHeader) -> StreamHeader:
    """The other header, its cameras renamed where the first has another of that name."""
    theirs = {camera.name: camera for camera in one.cameras}
    taken = {*theirs, *(camera.name for camera in other.cameras)}
    names: dict[str, str] = {}
    for camera in other.cameras:
        name = camera.name
        if name in theirs and not _is_same(theirs[name], one, camera, other):
            name = next(free for number in count(2) if (free := f"{camera.name}_{number}") not in taken)
            taken.add(name)
        names[camera.name] = name
    return with_cameras(other, names.get)


def _is_same(camera: Camera, header: StreamHeader, other: Camera, others: StreamHeader) -> bool:
    """Whether both headers say the same of a camera."""
    facts, other_facts = (
        (camera.name in says.held_out, says.camera_colours.get(camera.name)) for says in (header, others)
    )
    poses = np.array_equal(camera.world_to_camera, other.world_to_camera)
    return poses and facts == other_facts and replace(camera, world_to_camera=other.world_to_camera) == other
