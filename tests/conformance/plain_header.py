"""Section 4 of the plain decoder: the header packet."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from typing import Any

from plain_container import COEFFICIENTS, CORRECTIONS, EFFECTS, refuse

# Section 4: the header packet


@dataclass(frozen=True)
class Header:
    """What decoding needs of the header packet: the number of SH coefficients, the lattice, corrected cameras.

    And how the stream wants to be shown, its tracks of sound, how many layers it has, and what it says of profiles, as
    far as these are within their bounds.
    """

    coefficients: int
    lattice: dict[str, Any]
    corrected: dict[str, list[str]] = field(default_factory=dict)
    presentation: dict[str, Any] = field(default_factory=dict)
    sound: list[dict[str, Any]] = field(default_factory=list)
    fps: float | None = None
    layers: int = 1
    profiles: list[str] = field(default_factory=list)

    @property
    def channels(self) -> list[int]:
        return [3, 3, 4, 1, 3, 3 * (self.coefficients - 1)]


def read_header(payload: bytes) -> Header:
    if len(payload) > 1 << 20:
        refuse("too-large")
    header = read_json(payload)
    expect(isinstance(header, dict))
    check_header(header)
    if any(name not in EFFECTS for name in header["effects"]):
        refuse("unsupported-effect")
    return Header(
        (header["sh_degree"] + 1) ** 2,
        header["lattice"],
        header.get("corrected", {}),
        presentation_of(header),
        sound_of(header),
        header["fps"],
        layers_of(header),
        profiles_of(header),
    )


def presentation_of(header: dict[str, Any]) -> dict[str, Any]:
    """The members of the presentation that are within their bounds; the others count as absent."""
    told = header.get("presentation")
    if not isinstance(told, dict):
        return {}
    names = [camera["name"] for camera in header["cameras"]]
    is_good = {
        "title": lambda value: isinstance(value, str) and 0 < len(value) <= 65_536,
        "poster": lambda value: is_integer(value, 0, 2**31 - 1),
        "first_view": lambda value: isinstance(value, str) and value in names,
        "transform": is_transform,
    }
    return {name: told[name] for name, good in is_good.items() if name in told and good(told[name])}


def sound_of(header: dict[str, Any]) -> list[dict[str, Any]]:
    """The tracks of sound; none where anything of the list is out of bounds."""
    tracks, fps = header.get("sound"), header["fps"]
    if not isinstance(tracks, list) or not 1 <= len(tracks) <= 16 or fps is None or fps < 1:
        return []
    is_good = {
        "codec": lambda value: value == "opus",
        "channels": lambda value: is_integer(value, 1, 2),
        "title": lambda value: isinstance(value, str) and len(value) <= 65_536,
        "position": lambda value: is_vector(value, 3, -1e12, 1e12),
    }
    for track in tracks:
        if not (isinstance(track, dict) and {"codec", "channels"} <= track.keys()):
            return []
        if not all(good(track[name]) for name, good in is_good.items() if name in track):
            return []
    return [{name: track[name] for name in is_good if name in track} for track in tracks]


def layers_of(header: dict[str, Any]) -> int:
    """How many layers there are; one where anything of the list is out of bounds."""
    layers = header.get("layers")
    if not isinstance(layers, list) or not 2 <= len(layers) <= 4:
        return 1
    for number, layer in enumerate(layers):
        if not isinstance(layer, dict) or not is_integer(layer.get("gaussians"), 0, 2**27):
            return 1
        if not is_number(layer.get("bytes_per_frame"), 0, 1e9):
            return 1
        is_last = number == len(layers) - 1
        if "psnr" in layer if is_last else not is_number(layer.get("psnr"), 0, 200):
            return 1
    return len(layers)


def profiles_of(header: dict[str, Any]) -> list[str]:
    """The names, one for each layer; none where anything of the list is out of bounds."""
    names = header.get("profiles")
    if not isinstance(names, list) or len(names) != layers_of(header):
        return []
    good = all(isinstance(name, str) and len(name) <= 32 and name.isprintable() for name in names)
    return names if good else []


def is_transform(value: Any) -> bool:
    if not (isinstance(value, list) and len(value) == 3 and all(is_vector(row, 4, -1e12, 1e12) for row in value)):
        return False
    scale = math.copysign(abs(determinant(value)) ** (1 / 3), determinant(value))
    return 1e-6 <= scale <= 1e6 and is_rotation([[number / scale for number in row[:3]] for row in value])


def expect(condition: bool) -> None:
    if not condition:
        refuse("bad-header")


def read_json(payload: bytes) -> Any:
    try:
        text = payload.decode("utf-8")
        check_nesting(text)
        return json.loads(
            text,
            object_pairs_hook=json_object,
            parse_float=json_number,
            parse_int=json_integer,
            parse_constant=lambda _: refuse("bad-header"),
        )
    except ValueError:
        refuse("bad-header")


def check_nesting(text: str) -> None:
    depth, in_text, escaped = 0, False, False
    for character in text:
        if escaped:
            escaped = False
        elif in_text:
            escaped = character == "\\"
            in_text = character != '"'
        elif character == '"':
            in_text = True
        elif character in "[{":
            depth += 1
            expect(depth <= 16)
        elif character in "]}":
            depth -= 1


def json_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    members = dict(pairs)
    expect(len(members) == len(pairs))
    for name, value in pairs:
        expect_unicode(name)
        expect_unicode(value)
    return members


def expect_unicode(value: Any) -> None:
    if isinstance(value, str):
        expect(not any(0xD800 <= ord(character) < 0xE000 for character in value))
    elif isinstance(value, list):
        for item in value:
            expect_unicode(item)


def json_number(text: str) -> float:
    expect(math.isfinite(float(text)))
    return float(text)


def json_integer(text: str) -> int:
    json_number(text)
    return int(text)


def is_number(value: Any, least: float, most: float) -> bool:
    return type(value) in (int, float) and least <= value <= most


def is_integer(value: Any, least: int, most: int) -> bool:
    return type(value) is int and least <= value <= most


def is_vector(value: Any, length: int, least: float, most: float) -> bool:
    return isinstance(value, list) and len(value) == length and all(is_number(item, least, most) for item in value)


def is_name(value: Any) -> bool:
    if not isinstance(value, str) or not 1 <= len(value) <= 255 or value in (".", ".."):
        return False
    return not any(ord(c) < 32 or 127 <= ord(c) < 160 or c in "/\\" for c in value)


def is_names(value: Any) -> bool:
    return isinstance(value, list) and len(value) <= 1024 and all(map(is_name, value))


def check_header(header: dict[str, Any]) -> None:
    needed = "cameras lattice sh_degree fps first_frame background effects held_out axes units source_text licence"
    expect(all(name in header for name in [*needed.split(), "writer", "settings"]))
    cameras = header["cameras"]
    expect(isinstance(cameras, list) and 1 <= len(cameras) <= 1024)
    for camera in cameras:
        check_camera(camera)
    names = [camera["name"] for camera in cameras]
    expect(len(set(names)) == len(names))
    check_lattice(header["lattice"])
    expect(is_integer(header["sh_degree"], 0, 3))
    expect(header["fps"] is None or is_number(header["fps"], 1e-6, 1e6))
    expect(is_integer(header["first_frame"], 0, 2**31 - 1))
    expect(is_vector(header["background"], 3, -1000, 1000))
    expect(header.get("subject", True) is True)
    expect(is_names(header["effects"]))
    expect(is_names(header["held_out"]) and set(header["held_out"]) <= set(names))
    check_corrected(header, set(names) - set(header["held_out"]))
    lit = {camera["name"] for camera in cameras if "lamp" in camera}
    expect(lit >= set(header.get("corrected", {}).get("lamp_flicker", [])))
    for member, effect in (("colours", "colour_mismatch"), ("falloff", "lens_falloff"), ("lamp", "lamp_flicker")):
        different = {camera["name"] for camera in cameras if member in camera}
        expect(not different & set(header["held_out"]))
        expect(bool(different) == (effect in header["effects"]))
    for text in ("axes", "units", "source_text", "licence", "writer"):
        expect(isinstance(header[text], str) and len(header[text]) <= 65_536)
    expect(isinstance(header["settings"], dict))


def check_corrected(header: dict[str, Any], seen: set[str]) -> None:
    corrected = header.get("corrected", {})
    expect(isinstance(corrected, dict))
    for effect in CORRECTIONS:
        names = corrected.get(effect, [])
        expect(is_names(names) and len(set(names)) == len(names) and set(names) <= seen)
        expect(bool(names) == (effect in header["effects"]) or effect == "lamp_flicker")


def check_camera(camera: Any) -> None:
    expect(isinstance(camera, dict))
    needed = "name width height fx fy cx cy distortion_model distortion world_to_camera"
    expect(all(name in camera for name in needed.split()))
    expect(is_name(camera["name"]))
    expect(is_integer(camera["width"], 1, 32_768) and is_integer(camera["height"], 1, 32_768))
    expect(is_number(camera["fx"], 1e-3, 1e9) and is_number(camera["fy"], 1e-3, 1e9))
    expect(is_number(camera["cx"], -1e9, 1e9) and is_number(camera["cy"], -1e9, 1e9))
    model, distortion = camera["distortion_model"], camera["distortion"]
    expect(isinstance(model, str) and model in COEFFICIENTS and isinstance(distortion, list))
    expect(len(distortion) in COEFFICIENTS[model] and is_vector(distortion, len(distortion), -1e6, 1e6))
    rows = camera["world_to_camera"]
    expect(isinstance(rows, list) and len(rows) == 3 and all(is_vector(row, 4, -1e12, 1e12) for row in rows))
    expect(is_rotation([row[:3] for row in rows]))
    expect(is_number(camera.get("near", 0), 0, 1e12))
    colours = camera.get("colours", [0, 0, 0])
    expect(isinstance(colours, list) and len(colours) == 3)
    expect(all(is_integer(number, -32_767, 32_767) for number in colours))
    expect(is_integer(camera.get("falloff", 1), 1, 32_767))
    check_lamp(camera.get("lamp", LAMP))


LAMP = {"hertz": 100, "readout": 0.016, "columns": 1, "rows": 1, "sine": [0, 0, 0], "cosine": [0, 0, 0]}


def check_lamp(lamp: Any) -> None:
    expect(isinstance(lamp, dict) and LAMP.keys() <= lamp.keys())
    expect(is_number(lamp["hertz"], 1, 1e6) and is_number(lamp["readout"], -1, 1))
    expect(is_integer(lamp["columns"], 1, 16) and is_integer(lamp["rows"], 1, 16))
    for strengths in (lamp["sine"], lamp["cosine"]):
        expect(isinstance(strengths, list) and len(strengths) == 3 * lamp["columns"] * lamp["rows"])
        expect(all(is_integer(each, -32_767, 32_767) for each in strengths))


def is_rotation(r: list[list[float]]) -> bool:
    for i in range(3):
        for j in range(3):
            product = sum(r[i][axis] * r[j][axis] for axis in range(3))
            if not abs(product - (i == j)) <= 0.01:
                return False
    return determinant(r) > 0


def determinant(r: list[list[float]]) -> float:
    minors = [r[1][(a + 1) % 3] * r[2][(a + 2) % 3] - r[1][(a + 2) % 3] * r[2][(a + 1) % 3] for a in range(3)]
    return sum(r[0][axis] * minors[axis] for axis in range(3))


def check_lattice(lattice: Any) -> None:
    expect(isinstance(lattice, dict))
    scalars = ("log_scales", "quaternions", "opacity_logits", "sh_dc", "sh_rest")
    expect(all(name in lattice for name in ("origin", "means", *scalars)))
    expect(is_vector(lattice["origin"], 3, -1e12, 1e12) and is_vector(lattice["means"], 3, 1e-12, 1e6))
    expect(all(is_number(lattice[name], 1e-12, 1e6) for name in scalars) and lattice["quaternions"] <= 0.5)
