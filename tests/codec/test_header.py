"""The header packet: everything comes back, and nothing out of bounds is accepted."""

from __future__ import annotations

import json
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from decogs.codec.header.header import StreamHeader
from decogs.codec.header.presentation import Presentation
from decogs.codec.packets.corrections import Correction
from decogs.codec.scene.lattice import Lattice
from decogs.formats.cameras import Camera
from decogs.formats.errors import StreamError


def pose() -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = [[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]]
    matrix[:3, 3] = [0.1, -1 / 3, 1e-17]
    return matrix


FULL = StreamHeader(
    cameras=(
        Camera("cam00", 1352, 1014, 730.1, 729.9, 676.0, 507.0, np.eye(4)),
        Camera("wide", 640, 480, 300.0, 300.0, 320.0, 240.0, pose(), "fisheye", (0.1, 0.01, -0.001, 1e-5)),
        Camera("lens é", 640, 480, 300.0, 300.0, 320.0, 240.0, pose(), "opencv", (0.1, 0.01, 0.0, 0.0, -0.2)),
    ),
    lattice=Lattice((1.5, -2.0, 0.1), (0.001, 0.002, 0.003), 0.05, 1 / 128, 0.2, 1 / 64, 1 / 32),
    sh_degree=2,
    fps=29.97,
    first_frame=40,
    background=(0.0, 0.5, 1.0),
    effects=("motion", "emergence"),
    held_out=("cam00",),
    source_text="rig «Werkbank», filmed 2026",
    licence="CC-BY-4.0",
    settings={"preset": "default", "iterations": [150, 100], "tau": 25.0, "seed": 0, "flag": True, "none": None},
)


def test_every_field_comes_back() -> None:
    payload = FULL.to_bytes()
    back = StreamHeader.from_bytes(payload)
    for field in fields(StreamHeader):
        if field.name != "cameras":
            assert getattr(back, field.name) == getattr(FULL, field.name)
    for mine, theirs in zip(back.cameras, FULL.cameras, strict=True):
        assert np.array_equal(mine.world_to_camera, theirs.world_to_camera)
        assert {**vars(mine), "world_to_camera": None} == {**vars(theirs), "world_to_camera": None}
    assert back.to_bytes() == payload


@pytest.mark.parametrize(
    ("falloffs", "expected"),
    [([], 0), ([900], 900), ([900, 0], 0), ([400, 900, 0], 400), ([0, 0, 900], 0), ([300, 700, 500, 900], 500)],
)
def test_a_held_out_camera_darkens_its_border_as_the_middle_one_of_the_others(
    falloffs: list[int], expected: int
) -> None:
    names = [f"trained{number}" for number in range(len(falloffs))]
    cameras = tuple(replace(FULL.cameras[0], name=name) for name in ("held out", *names))
    colours = {name: Correction(exposure=70, falloff=each) for name, each in zip(names, falloffs, strict=True) if each}
    header = replace(FULL, cameras=cameras, held_out=("held out",), camera_colours=colours)
    assert header.colours_of("held out") == (Correction(falloff=expected) if expected else None)
    assert all(header.colours_of(name) == colours.get(name) for name in names)


def test_numpy_numbers_from_a_rig_can_be_written() -> None:
    camera = replace(FULL.cameras[0], width=np.int64(64), fx=np.float32(50), name="a")
    header = replace(FULL, cameras=(camera,), held_out=(), fps=np.float64(25), background=np.zeros(3))
    assert StreamHeader.from_bytes(header.to_bytes()).cameras[0].width == 64


def test_members_of_later_minor_versions_are_left_alone() -> None:
    document = json.loads(FULL.to_bytes())
    document["invented_later"] = {"x": 1}
    assert StreamHeader.from_bytes(json.dumps(document).encode()).fps == 29.97


def test_a_subject_says_so_and_a_whole_scene_says_nothing() -> None:
    subject = replace(FULL, subject=True).to_bytes()
    assert b'"subject":true' in subject
    assert StreamHeader.from_bytes(subject).subject
    assert b"subject" not in FULL.to_bytes()


SHOWN = Presentation("Zwei Tänzer", 3, "wide", ((0, 0, 2.5, 1), (2.5, 0, 0, -3), (0, 2.5, 0, 1 / 3)))


def test_a_presentation_comes_back_and_costs_nothing_where_there_is_none() -> None:
    shown = replace(FULL, presentation=SHOWN).to_bytes()
    assert StreamHeader.from_bytes(shown).presentation == SHOWN
    assert b"presentation" not in FULL.to_bytes()
    assert b'"title"' not in replace(FULL, presentation=Presentation(poster=0)).to_bytes()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("title", value) for value in ("x" * 65_537, 5, None, ["x"])),
        *(("poster", value) for value in (-1, 1 << 31, 1.0, True, "1")),
        *(("first_view", value) for value in ("nobody", "", 1, ["wide"])),
        ("transform", [[1, 0, 0, 0], [0, 1, 0, 0]]),
        ("transform", [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0]]),
        ("transform", [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2e12]]),
    ],
)
def test_what_is_out_of_bounds_in_a_presentation_counts_as_absent(name: str, value: object) -> None:
    document = json.loads(replace(FULL, presentation=SHOWN).to_bytes())
    document["presentation"][name] = value
    left = {other: kept for other, kept in vars(SHOWN).items() if other != name}
    assert StreamHeader.from_bytes(json.dumps(document).encode()).presentation == Presentation(**left)
    with pytest.raises(StreamError, match="presentation is out of its bounds"):
        replace(FULL, presentation=replace(SHOWN, **{name: value or 5})).to_bytes()


@pytest.mark.parametrize("value", [[], None, "title", 3, {}, {"title": ""}])
def test_no_presentation_is_none(value: object) -> None:
    document = json.loads(FULL.to_bytes()) | {"presentation": value}
    assert StreamHeader.from_bytes(json.dumps(document).encode()).presentation == Presentation()


CHANGES = [
    ("sh_degree", 4),
    ("sh_degree", True),
    ("sh_degree", 1.0),
    ("fps", 0),
    ("fps", "30"),
    ("first_frame", -1),
    ("background", [0, 0]),
    ("background", [0, 0, "x"]),
    ("cameras", []),
    ("cameras", {}),
    ("held_out", ["nobody"]),
    ("held_out", "cam00"),
    ("axes", 5),
    ("writer", "x" * 70000),
    ("settings", []),
    ("subject", False),
    ("subject", 1),
    ("lattice", None),
    ("lattice.means", [0.001, 0.001, 0]),
    ("lattice.means", [0.001, 0.001]),
    ("lattice.log_scales", 1e-300),
    ("lattice.quaternions", 0.6),
    ("lattice.sh_dc", -1),
    ("lattice.origin", [0, 0, 1e13]),
    ("cameras.0.name", ""),
    ("cameras.0.name", "../x"),
    ("cameras.0.name", "a\\b"),
    ("cameras.0.name", "a\u0000"),
    ("cameras.0.name", "wide"),
    ("cameras.0.width", 0),
    ("cameras.0.height", 1 << 20),
    ("cameras.0.fx", 0),
    ("cameras.0.fy", -5),
    ("cameras.0.cx", None),
    ("cameras.0.distortion_model", "panini"),
    ("cameras.0.distortion", [1.0]),
    ("cameras.1.distortion", []),
    ("cameras.2.distortion", [0, 0, 0, 0, 0, 0]),
    ("cameras.0.world_to_camera", [[1, 0, 0, 0], [0, 1, 0, 0]]),
    ("cameras.0.world_to_camera", [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 0]]),
    ("cameras.0.world_to_camera", [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0]]),
    ("cameras.0.world_to_camera", [[1e12, 1e12, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]),
]


@pytest.mark.parametrize(("path", "value"), CHANGES)
def test_fields_out_of_bounds_are_refused(path: str, value: object) -> None:
    document = json.loads(FULL.to_bytes())
    *parents, last = path.split(".")
    place = document
    for name in parents:
        place = place[int(name)] if name.isdigit() else place[name]
    place[last] = value
    with pytest.raises(StreamError) as caught:
        StreamHeader.from_bytes(json.dumps(document).encode())
    assert caught.value.reason == "bad-header"


OPTIONAL = ("corrected", "camera_colours", "subject", "presentation", "sound", "layers", "profiles")


@pytest.mark.parametrize("name", [field.name for field in fields(StreamHeader) if field.name not in OPTIONAL])
def test_missing_fields_are_refused_by_name(name: str) -> None:
    document = json.loads(FULL.to_bytes())
    del document[name]
    with pytest.raises(StreamError, match=rf"{name} is missing.*\[bad-header\]"):
        StreamHeader.from_bytes(json.dumps(document).encode())


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"null",
        b"[]",
        b'{"fps":1,"fps":1}',
        b'{"fps":NaN}',
        b'{"fps":1e999}',
        b'{"fps":' + b"9" * 5000 + b"}",
        b"[" * 500_000,
        b'{"a":' * 100_000,
        b'"' + b"[" * 40,
        b"\xff\xfe",
        b'{"axes":"\\ud800"}',
        b'"' + b'\\"' * 500_000,
        b'"' + b'\\"' * 500_000 + b"\\",
        FULL.to_bytes()[:-1],
        FULL.to_bytes() + b"x",
    ],
    ids=lambda payload: repr(payload[:12]),
)
def test_what_is_no_json_object_of_ours_is_refused(payload: bytes) -> None:
    with pytest.raises(StreamError) as caught:
        StreamHeader.from_bytes(payload)
    assert caught.value.reason == "bad-header"


def test_headers_above_the_limit_are_refused() -> None:
    with pytest.raises(StreamError, match="too-large"):
        StreamHeader.from_bytes(b" " * ((1 << 20) + 1))


def test_effects_this_decoder_cannot_show_are_refused() -> None:
    with pytest.raises(StreamError, match=r"time_travel.*\[unsupported-effect\]"):
        replace(FULL, effects=("motion", "time_travel")).to_bytes()


def test_settings_that_json_cannot_hold_are_refused_when_written() -> None:
    with pytest.raises(StreamError, match="bad-header"):
        replace(FULL, settings={"tau": float("nan")}).to_bytes()


@given(st.integers(0, 10**6), st.binary(max_size=6))
@settings(deadline=None)
def test_mutated_headers_raise_stream_errors_only(position: int, patch: bytes) -> None:
    payload = bytearray(FULL.to_bytes())
    start = position % len(payload)
    payload[start : start + len(patch)] = patch
    try:
        StreamHeader.from_bytes(bytes(payload))
    except StreamError:
        return


def test_near_plane_survives_and_is_left_out_when_there_is_none() -> None:
    camera = replace(FULL.cameras[0], near=0.25)
    with_near = replace(FULL, cameras=(camera, *FULL.cameras[1:]))
    assert StreamHeader.from_bytes(with_near.to_bytes()).cameras[0].near == 0.25
    assert b'"near"' not in FULL.to_bytes()
