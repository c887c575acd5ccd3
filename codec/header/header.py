"""The header packet: all a decoder needs without the rig, as strict JSON (SPEC.md, "Header packet")."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, NoReturn, TypeVar

import numpy as np

from decogs.formats.cameras import Camera
from decogs.formats.errors import StreamError
from decogs.formats.geometry.rotations import is_orthonormal
from decogs.formats.stream.container import PACKET_HEADER_SIZE, PROLOGUE_SIZE
from decogs.formats.stream.reasons import Reason

from ..packets.corrections import (
    ALWAYS_LIT,
    EFFECT_FIELDS,
    LARGEST,
    CorrectedCameras,
    Correction,
    Corrections,
    LampWave,
)
from ..packets.sound import SoundTrack, read_sound_tracks
from ..scene.lattice import Lattice, Vector
from .layer_list import Layer, read_layers
from .presentation import Presentation, read_presentation
from .profiles import read_profiles

MAX_HEADER_BYTES = 1 << 20
MAX_CAMERAS = 1024
MAX_DEPTH = 16
MAX_SIDE = 1 << 15
_MAX_LAMP_CELLS = 16
_MAX_HERTZ = 1e6
_MAX_TEXT = 1 << 16
_MAX_NAME = 255
_STEP_RANGE = (1e-12, 1e6)
_QUATERNION_STEP_MAX = 0.5
_COORDINATE_MAX = 1e12
_RIGID_TOLERANCE = 1e-2

LAMP_EFFECT = "lamp_flicker"
CONSTANT_EFFECTS = ("colour_mismatch", "lens_falloff")
"""Effects in which cameras differ from the scene in every frame alike: the header has them, no frame."""
EFFECTS = frozenset(
    {
        *("motion", "appearance_change", "emergence", "disappearance", "view_dependence", "lens_distortion"),
        *CONSTANT_EFFECTS,
        *EFFECT_FIELDS,
    }
)
"""Effects a 1.0 decoder reproduces; a stream that names another one asks for more than this decoder can do."""

_COEFFICIENT_COUNTS = {"none": (0,), "opencv": (4, 5, 8), "fisheye": (4,)}
_STRING = re.compile(rb'"(?:[^"\\]|\\.)*(?:"|\\?\Z)', re.DOTALL)
"""A JSON string, or an unfinished one to the end: no second try at the same bytes, so the search stays linear."""
_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f]")

_T = TypeVar("_T")


@dataclass(frozen=True, eq=False)
class StreamHeader:
    """What the first packet says. How many frames follow is not known: a stream may still be growing.

    ``cameras``: the rig's, held-out ones included, which ``held_out`` names; ``fps`` None when unknown;
    ``first_frame``: the rig's index of the stream's frame 0; ``background``: the colour trained against,
    display-referred RGB; ``corrected``: the cameras whose corrections every frame codes; ``camera_colours``: by camera,
    how its exposure, red and blue differ from the scene's in every frame, and how its border darkens; ``settings``: the
    encoder's own, for people, never needed for decoding; ``subject``: the scene is a subject without its surroundings,
    its alpha what it covers; ``presentation``: how it wants to be shown; ``sound``: the tracks that are played
    together, which packets beside the frames hold; ``layers``: the base and what refines it, none where the frames'
    packets hold the whole scene; ``profiles``: of each layer, or the one, the first profile that it keeps within, empty
    for none; nothing where that is not said.
    """

    cameras: tuple[Camera, ...]
    lattice: Lattice
    sh_degree: int = 0
    fps: float | None = None
    first_frame: int = 0
    background: Vector = (0.0, 0.0, 0.0)
    effects: tuple[str, ...] = ()
    held_out: tuple[str, ...] = ()
    axes: str = "right-handed world; cameras look along +z, x right, y down"
    units: str = "world units of the rig's calibration"
    source_text: str = ""
    licence: str = ""
    writer: str = "decogs"
    settings: Mapping[str, Any] = field(default_factory=dict)
    corrected: CorrectedCameras = field(default_factory=CorrectedCameras)
    camera_colours: Corrections = field(default_factory=dict)
    subject: bool = False
    presentation: Presentation = field(default_factory=Presentation)
    sound: tuple[SoundTrack, ...] = ()
    layers: tuple[Layer, ...] = ()
    profiles: tuple[str, ...] = ()

    @property
    def near_planes(self) -> dict[str, float]:
        """Near plane of every camera by name, world units."""
        return {camera.name: camera.near for camera in self.cameras}

    def camera_effects(self, name: str) -> tuple[str, ...]:
        """The effects in which a camera's pictures differ from the scene's own."""
        own = {name: self.camera_colours[name]} if name in self.camera_colours else {}
        return (*constant_effects(own), *self.corrected.of(name))

    def colours_of(self, name: str) -> Correction | None:
        """How a camera's colours differ from the scene's in every frame; None where they do not.

        Of a held-out camera nothing is known but that it is one of the rig's: it darkens its border as the middle one
        of the others does. Source: SPEC.md, "Corrections".
        """
        if name not in self.held_out:
            return self.camera_colours.get(name)
        none = Correction()
        others = [camera.name for camera in self.cameras if camera.name not in self.held_out]
        falloffs = sorted(self.camera_colours.get(other, none).falloff for other in others)
        middle = falloffs[(len(falloffs) - 1) // 2] if falloffs else 0
        return Correction(falloff=middle) if middle else None

    @property
    def coefficients(self) -> int:
        """SH coefficients per colour channel."""
        return (self.sh_degree + 1) ** 2

    def to_bytes(self) -> bytes:
        """The header packet's payload in canonical form; raises StreamError when a field is out of its bounds."""
        document = {
            "axes": self.axes,
            "background": _floats(self.background),
            "cameras": [_camera_document(camera, self.camera_colours.get(camera.name)) for camera in self.cameras],
            **({"corrected": _corrected_document(self.corrected)} if self.corrected.effects else {}),
            "effects": list(self.effects),
            "first_frame": self.first_frame,
            "fps": None if self.fps is None else float(self.fps),
            "held_out": list(self.held_out),
            "lattice": _lattice_document(self.lattice),
            **({"layers": [layer.as_document() for layer in self.layers]} if self.layers else {}),
            "licence": self.licence,
            **({"presentation": shown} if (shown := self.presentation.as_document()) else {}),
            **({"profiles": list(self.profiles)} if self.profiles else {}),
            "settings": dict(self.settings),
            "sh_degree": self.sh_degree,
            **({"sound": [track.as_document() for track in self.sound]} if self.sound else {}),
            "source_text": self.source_text,
            **({"subject": True} if self.subject else {}),
            "units": self.units,
            "writer": self.writer,
        }
        try:
            text = json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
        except ValueError as error:
            raise StreamError(Reason.BAD_HEADER, f"the header cannot be written: {error}") from error
        payload = text.encode("ascii")
        read = StreamHeader.from_bytes(payload)
        if read.presentation != self.presentation:
            _refuse("a member of presentation is out of its bounds")
        if read.sound != self.sound:
            _refuse("sound is out of its bounds, or lacks a frame rate of at least 1")
        if read.layers != self.layers:
            _refuse("layers are out of their bounds")
        if read.profiles != self.profiles:
            _refuse("profiles are not as many as layers")
        return payload

    @staticmethod
    def from_bytes(payload: bytes) -> StreamHeader:
        """Reads and checks every field; raises StreamError "bad-header" or "unsupported-effect"."""
        fields = _Fields(_parse(payload), "")
        header = StreamHeader(
            cameras=tuple(
                _camera(_Fields(camera, f"cameras[{i}]."))
                for i, camera in enumerate(fields.list("cameras", 1, MAX_CAMERAS))
            ),
            lattice=_lattice(_Fields(fields.value("lattice"), "lattice.")),
            sh_degree=fields.integer("sh_degree", 0, 3),
            fps=fields.optional("fps", lambda: fields.number("fps", 1e-6, 1e6)),
            first_frame=fields.integer("first_frame", 0, (1 << 31) - 1),
            background=fields.vector("background", -1e3, 1e3),
            effects=tuple(fields.names("effects")),
            held_out=tuple(fields.names("held_out")),
            axes=fields.text("axes"),
            units=fields.text("units"),
            source_text=fields.text("source_text"),
            licence=fields.text("licence"),
            writer=fields.text("writer"),
            settings=fields.settings("settings"),
            corrected=_corrected(fields) if fields.has("corrected") else CorrectedCameras(),
            subject=fields.flag("subject"),
        )
        header = replace(header, camera_colours=_camera_colours(fields, header.corrected))
        names = [camera.name for camera in header.cameras]
        if fields.has("presentation"):
            header = replace(header, presentation=read_presentation(fields.value("presentation"), names))
        if fields.has("sound"):
            header = replace(header, sound=read_sound_tracks(fields.value("sound"), header.fps))
        if fields.has("layers"):
            header = replace(header, layers=read_layers(fields.value("layers")))
        if fields.has("profiles"):
            header = replace(header, profiles=read_profiles(fields.value("profiles"), max(1, len(header.layers))))
        if len(set(names)) != len(names):
            _refuse("two cameras have the same name")
        if not set(header.held_out) <= set(names):
            _refuse("held_out names a camera that the stream does not have")
        _check_corrected(header)
        _check_colours(header)
        unknown = sorted(set(header.effects) - EFFECTS)
        if unknown:
            _refuse(f"this decoder does not know the effect {unknown[0]!r}", Reason.UNSUPPORTED_EFFECT)
        return header


def unknown_members(payload: bytes) -> list[str]:
    """What a header packet says that this version does not know, or that is out of its bounds, as paths."""
    return list(_beyond(_parse(payload), _parse(StreamHeader.from_bytes(payload).to_bytes()), ""))


def _beyond(document: Any, understood: Any, path: str) -> Iterator[str]:
    """Members of one document that another lacks, but for those that say nothing."""
    if isinstance(document, list) and isinstance(understood, list) and len(document) == len(understood):
        for index, (value, other) in enumerate(zip(document, understood, strict=True)):
            yield from _beyond(value, other, f"{path}[{index}]")
    elif isinstance(document, dict) and isinstance(understood, dict):
        for name, value in document.items():
            path_of_value = f"{path}.{name}" if path else name
            if name in understood:
                yield from _beyond(value, understood[name], path_of_value)
            elif value:
                yield path_of_value


class _Fields:
    """One JSON object whose members are taken by name, type and bounds; unknown members are left alone."""

    def __init__(self, value: Any, path: str) -> None:
        if not isinstance(value, dict):
            _refuse(f"{path.rstrip('.') or 'the header'} is no object")
        self._members: dict[str, Any] = value
        self._path = path

    def value(self, name: str) -> Any:
        if name not in self._members:
            self._refuse(name, "is missing")
        return self._members[name]

    def has(self, name: str) -> bool:
        return name in self._members

    def optional(self, name: str, read: Callable[[], _T]) -> _T | None:
        return None if self.value(name) is None else read()

    def number(self, name: str, low: float, high: float) -> float:
        return self._number(name, self.value(name), low, high)

    def integer(self, name: str, low: int, high: int) -> int:
        value = self.value(name)
        if type(value) is not int or not low <= value <= high:
            self._refuse(name, f"is no integer from {low} to {high}")
        return int(value)

    def flag(self, name: str) -> bool:
        """Whether the member is there; it can only be true."""
        if self.has(name) and self.value(name) is not True:
            self._refuse(name, "is not true; leave it out instead")
        return self.has(name)

    def text(self, name: str, longest: int = _MAX_TEXT) -> str:
        return self._text(name, self.value(name), longest)

    def name(self, name: str) -> str:
        """A text that may stand in a file name: no separators, no control characters, not empty."""
        return self._name(name, self.value(name))

    def names(self, name: str) -> list[str]:
        return [self._name(name, value) for value in self.list(name, 0, MAX_CAMERAS)]

    def list(self, name: str, shortest: int, longest: int) -> list[Any]:
        value = self.value(name)
        if not isinstance(value, list) or not shortest <= len(value) <= longest:
            self._refuse(name, f"is no list of {shortest} to {longest} members")
        return value

    def numbers(self, name: str, counts: tuple[int, ...], low: float, high: float) -> tuple[float, ...]:
        values = self.list(name, min(counts), max(counts))
        if len(values) not in counts:
            self._refuse(name, f"has {len(values)} numbers")
        return tuple(self._number(name, value, low, high) for value in values)

    def integers(self, name: str, count: int, largest: int) -> tuple[int, ...]:
        """So many, none of a larger magnitude."""
        values = self.list(name, count, count)
        if any(type(value) is not int or abs(value) > largest for value in values):
            self._refuse(name, f"holds no {count} integers of magnitude at most {largest}")
        return tuple(values)

    def vector(self, name: str, low: float, high: float) -> Vector:
        x, y, z = self.numbers(name, (3,), low, high)
        return x, y, z

    def settings(self, name: str) -> dict[str, Any]:
        value = self.value(name)
        if not isinstance(value, dict):
            self._refuse(name, "is no object")
        return value

    def _number(self, name: str, value: Any, low: float, high: float) -> float:
        if type(value) not in (int, float) or not low <= value <= high:
            self._refuse(name, f"is no number from {low:g} to {high:g}")
        return float(value)

    def _text(self, name: str, value: Any, longest: int) -> str:
        if not isinstance(value, str) or len(value) > longest:
            self._refuse(name, f"is no text of at most {longest} characters")
        return str(value)

    def _name(self, name: str, value: Any) -> str:
        text = self._text(name, value, _MAX_NAME)
        if not text or text in (".", "..") or "/" in text or "\\" in text or _CONTROL.search(text):
            self._refuse(name, "is empty or holds a path separator or control character")
        return text

    def _refuse(self, name: str, problem: str) -> NoReturn:
        _refuse(f"{self._path}{name} {problem}")


def _parse(payload: bytes) -> Any:
    """JSON of bounded size and depth, every name once, numbers finite."""
    if len(payload) > MAX_HEADER_BYTES:
        _refuse(f"{len(payload)} bytes are above the limit", Reason.TOO_LARGE)
    brackets = np.frombuffer(_STRING.sub(b"", payload), np.uint8)
    steps = np.isin(brackets, [ord("["), ord("{")]).astype(np.int64) - np.isin(brackets, [ord("]"), ord("}")])
    if np.cumsum(steps).max(initial=0) > MAX_DEPTH:
        _refuse("is nested too deeply")
    try:
        document = json.loads(
            payload.decode("utf-8"),
            object_pairs_hook=_unique_members,
            parse_constant=lambda name: _refuse(f"holds {name}"),
            parse_float=_finite,
            parse_int=_finite_integer,
        )
        # Half a surrogate pair is a text that cannot be printed.
        json.dumps(document, ensure_ascii=False).encode("utf-8")
        return document
    except ValueError as error:
        _refuse(f"is no valid JSON: {error}")


def _unique_members(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    members = dict(pairs)
    if len(members) != len(pairs):
        _refuse("names a field twice")
    return members


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        _refuse(f"holds the number {text[:20]}, which is not finite")
    return value


def _finite_integer(text: str) -> int:
    _finite(text)
    return int(text)


def _refuse(problem: str, reason: str = Reason.BAD_HEADER) -> NoReturn:
    raise StreamError(reason, f"header: {problem}", packet=0, offset=PROLOGUE_SIZE + PACKET_HEADER_SIZE)


def _floats(values: Any) -> list[float]:
    return [float(value) for value in values]


def _camera_document(camera: Camera, colours: Correction | None) -> dict[str, Any]:
    return {
        **({"colours": [colours.exposure, colours.red, colours.blue]} if colours and _has_colours(colours) else {}),
        "cx": float(camera.cx),
        "cy": float(camera.cy),
        "distortion": _floats(camera.distortion),
        "distortion_model": camera.distortion_model,
        **({"falloff": colours.falloff} if colours and colours.falloff else {}),
        "fx": float(camera.fx),
        "fy": float(camera.fy),
        "height": int(camera.height),
        **({"lamp": _lamp_document(colours.lamp)} if colours and colours.lamp else {}),
        "name": camera.name,
        **({"near": float(camera.near)} if camera.near else {}),
        "width": int(camera.width),
        "world_to_camera": [_floats(row) for row in camera.world_to_camera[:3]],
    }


def _camera(fields: _Fields) -> Camera:
    model = fields.text("distortion_model", _MAX_NAME)
    if model not in _COEFFICIENT_COUNTS:
        _refuse(f"distortion model {model[:40]!r} is unknown")
    return Camera(
        name=fields.name("name"),
        width=fields.integer("width", 1, MAX_SIDE),
        height=fields.integer("height", 1, MAX_SIDE),
        fx=fields.number("fx", 1e-3, 1e9),
        fy=fields.number("fy", 1e-3, 1e9),
        cx=fields.number("cx", -1e9, 1e9),
        cy=fields.number("cy", -1e9, 1e9),
        world_to_camera=_pose(fields),
        distortion_model=model,  # type: ignore[arg-type]
        distortion=fields.numbers("distortion", _COEFFICIENT_COUNTS[model], -1e6, 1e6),
        near=fields.number("near", 0.0, _COORDINATE_MAX) if fields.has("near") else 0.0,
    )


def _lamp_document(lamp: LampWave) -> dict[str, Any]:
    return {**asdict(lamp), "sine": list(lamp.sine), "cosine": list(lamp.cosine)}


def _lamp(fields: _Fields) -> LampWave:
    columns, rows = (fields.integer(side, 1, _MAX_LAMP_CELLS) for side in ("columns", "rows"))
    maps = {name: fields.integers(name, 3 * columns * rows, LARGEST) for name in ("sine", "cosine")}
    return LampWave(
        fields.number("hertz", 1, _MAX_HERTZ),
        fields.number("readout", -1, 1),
        columns,
        rows,
        maps["sine"],
        maps["cosine"],
    )


def _pose(fields: _Fields) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    rows = fields.list("world_to_camera", 3, 3)
    inner = [
        _Fields({"row": row}, "world_to_camera.").numbers("row", (4,), -_COORDINATE_MAX, _COORDINATE_MAX)
        for row in rows
    ]
    pose = np.eye(4)
    pose[:3] = inner
    rotation = pose[:3, :3]
    if not is_orthonormal(rotation, _RIGID_TOLERANCE):
        _refuse("world_to_camera is no rigid motion")
    if np.linalg.det(rotation) < 0:
        _refuse("world_to_camera mirrors the scene")
    return pose


def _corrected_document(corrected: CorrectedCameras) -> dict[str, Any]:
    return {effect: list(getattr(corrected, effect)) for effect in corrected.effects}


def _corrected(fields: _Fields) -> CorrectedCameras:
    members = _Fields(fields.value("corrected"), "corrected.")
    return CorrectedCameras(**{effect: tuple(members.names(effect)) for effect in EFFECT_FIELDS if members.has(effect)})


def _check_corrected(header: StreamHeader) -> None:
    """Every effect that corrects cameras says which, each once; what training did not see has no corrections."""
    corrected, seen = header.corrected, {camera.name for camera in header.cameras} - set(header.held_out)
    for effect in EFFECT_FIELDS:
        names = getattr(corrected, effect)
        if bool(names) != (effect in header.effects) and effect != LAMP_EFFECT:
            _refuse(f"effects and corrected disagree on {effect}")
        if len(set(names)) != len(names) or not set(names) <= seen:
            _refuse(f"corrected.{effect} names a camera twice, or one that training did not see")


def _camera_colours(fields: _Fields, corrected: CorrectedCameras) -> dict[str, Correction]:
    """Of the cameras that have them: exposure, red and blue, the fall-off, and lamps."""
    colours = {}
    for number, document in enumerate(fields.list("cameras", 1, MAX_CAMERAS)):
        camera = _Fields(document, f"cameras[{number}].")
        if any(map(camera.has, ("colours", "falloff", "lamp"))):
            exposure, red, blue = camera.integers("colours", 3, LARGEST) if camera.has("colours") else (0, 0, 0)
            falloff = camera.integer("falloff", 1, LARGEST) if camera.has("falloff") else 0
            own = Correction(exposure, red, blue, falloff=falloff)
            if camera.has("lamp"):
                lamp = _lamp(_Fields(camera.value("lamp"), f"cameras[{number}].lamp."))
                always = 0 if camera.name("name") in corrected.lamp_flicker else ALWAYS_LIT
                own = replace(own, lamp=lamp, lamp_amplitude=always)
            colours[camera.name("name")] = own
    return colours


def constant_effects(colours: Corrections) -> tuple[str, ...]:
    """The effects in which cameras with these ``colours`` differ from the scene in every frame."""
    mismatch = any(map(_has_colours, colours.values()))
    falloff = any(each.falloff for each in colours.values())
    lit = any(each.has_wave for each in colours.values())
    there = (("colour_mismatch", mismatch), ("lens_falloff", falloff), (LAMP_EFFECT, lit))
    return tuple(effect for effect, is_there in there if is_there)


def _has_colours(colours: Correction) -> bool:
    """Whether a camera has colours of its own, zeros among them; those with a fall-off or a lamp alone have none."""
    return colours.has_gain or not (colours.falloff or colours.lamp)


def _check_colours(header: StreamHeader) -> None:
    """Colours are there where their effects are named, and not of a camera that training did not see."""
    there = constant_effects(header.camera_colours)
    for effect in CONSTANT_EFFECTS:
        if (effect in there) != (effect in header.effects):
            _refuse(f"effects and the cameras' colours disagree on {effect}")
    lit = {name for name, each in header.camera_colours.items() if each.lamp}
    if not set(header.corrected.lamp_flicker) <= lit or bool(lit) != (LAMP_EFFECT in header.effects):
        _refuse(f"cameras with a lamp, corrected.{LAMP_EFFECT} and effects disagree")
    if set(header.camera_colours) & set(header.held_out):
        _refuse("a camera that training did not see has colours")


def _lattice_document(lattice: Lattice) -> dict[str, Any]:
    return {
        "log_scales": float(lattice.log_scales),
        "means": _floats(lattice.means),
        "opacity_logits": float(lattice.opacity_logits),
        "origin": _floats(lattice.origin),
        "quaternions": float(lattice.quaternions),
        "sh_dc": float(lattice.sh_dc),
        "sh_rest": float(lattice.sh_rest),
    }


def _lattice(fields: _Fields) -> Lattice:
    return Lattice(
        origin=fields.vector("origin", -_COORDINATE_MAX, _COORDINATE_MAX),
        means=fields.vector("means", *_STEP_RANGE),
        log_scales=fields.number("log_scales", *_STEP_RANGE),
        quaternions=fields.number("quaternions", _STEP_RANGE[0], _QUATERNION_STEP_MAX),
        opacity_logits=fields.number("opacity_logits", *_STEP_RANGE),
        sh_dc=fields.number("sh_dc", *_STEP_RANGE),
        sh_rest=fields.number("sh_rest", *_STEP_RANGE),
    )
