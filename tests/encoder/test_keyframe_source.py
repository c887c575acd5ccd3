"""The keyframe of an earlier encode: taken over bit for bit, and refused where the comparison would not be fair."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decogs.codec.scene.lattice import dequantise
from decogs.encoder.input.imported_keyframe import read_keyframe
from decogs.formats.errors import DecogsError, StreamError, UsageError
from decogs.formats.stream.container import Packet, PacketKind, PacketReader


def packets(path: Path) -> dict[int, Packet]:
    """The first packet of every kind."""
    found: dict[int, Packet] = {}
    with path.open("rb") as file:
        reader = PacketReader(file)
        while (packet := reader.next()) is not None:
            found.setdefault(packet.kind, packet)
    return found


def never(*_: Any) -> None:
    raise AssertionError("a keyframe was trained")


def test_an_encode_from_its_own_keyframe_gives_the_same_file(encode: Any, moving: Any, moving_rig: Path) -> None:
    again = encode(moving_rig, keyframe=moving.path, on_keyframe_step=never)
    assert again.data == moving.data
    assert not {"first_points", "keyframe"} & set(again.report.frames[0].seconds)


def test_other_settings_begin_with_the_same_keyframe(
    encode: Any, moving: Any, moving_rig: Path, tiny_settings: Any
) -> None:
    changed = replace(
        tiny_settings,
        keyframe=replace(tiny_settings.keyframe, sh_degree=0, iterations=9),
        lattice_scale=4.0,
    )
    other = encode(moving_rig, settings=changed, keyframe=moving.path, seed=5, on_keyframe_step=never, stop=2)
    ours, theirs = packets(other.path), packets(moving.path)
    assert ours[PacketKind.KEY].payload == theirs[PacketKind.KEY].payload
    assert ours[PacketKind.DELTA].payload != theirs[PacketKind.DELTA].payload
    one, two = read_keyframe(other.path).header, read_keyframe(moving.path).header
    assert (one.lattice, one.sh_degree, one.effects) == (two.lattice, two.sh_degree, two.effects)
    assert [camera.near for camera in one.cameras] == [camera.near for camera in two.cameras]
    assert all(camera.near > 0 for camera in one.cameras)
    # The header says how the keyframe was made, and how the rest.
    for name in ("keyframe", "lattice_scale"):
        assert one.settings[name] == two.settings[name]
    assert one.settings["seed"] == 5


def test_a_stream_that_was_cut_off_will_do(encode: Any, moving: Any, moving_rig: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.dgs"
    key = packets(moving.path)[PacketKind.KEY]
    cut.write_bytes(moving.data[: key.offset + key.size + 10])
    assert encode(moving_rig, keyframe=cut).data == moving.data


@contextmanager
def refused(encode: Any, moving: Any, message: str, error: type[DecogsError] = UsageError) -> Iterator[Any]:
    with pytest.raises(error, match=message) as raised:
        yield lambda rig, **options: encode(rig, **({"keyframe": moving.path, "on_keyframe_step": never} | options))
    assert "\n" not in str(raised.value)


def test_other_held_out_cameras_are_refused(encode: Any, moving: Any, moving_rig: Path) -> None:
    """cam03 was trained on; that cam02 was not is no reason to leave it unmeasured now."""
    for held_out, now in ((["cam03"], "cam03"), (["cam02", "cam03"], "cam02, cam03"), ([], "no camera")):
        message = f"it was trained with cam02 held out, this encode holds out {now}; use the same `holdout`"
        with refused(encode, moving, message) as run:
            run(moving_rig, holdout=held_out)


def test_another_first_frame_is_refused(encode: Any, moving: Any, moving_rig: Path) -> None:
    with refused(encode, moving, "it begins with frame 0 of the rig, not 1; use `frames` 0:") as run:
        run(moving_rig, start=1)


@pytest.mark.parametrize(
    ("field", "message"),
    [
        ("fx", "the fx of its camera cam01"),
        ("world_to_camera", "the pose of its camera cam01"),
        ("name", "its cameras are not"),
    ],
)
def test_another_rig_is_refused(
    encode: Any, moving: Any, moving_rig: Path, tmp_path: Path, field: str, message: str
) -> None:
    rig = tmp_path / "rig"
    shutil.copytree(moving_rig, rig)
    document = json.loads((rig / "rig.json").read_text())
    camera = document["cameras"][1]
    if field == "name":
        camera["name"] = "cam01b"
    else:
        values = np.array(camera[field])
        values.flat[0 if field == "fx" else 3] += 1e-6  # of a pose, the first entry of the translation
        camera[field] = values.tolist()
    (rig / "rig.json").write_text(json.dumps(document))
    with refused(encode, moving, f"`keyframe` {moving.path}: {message}.* this rig's; give a stream of the same") as run:
        run(rig)


def test_a_rig_with_lenses_is_another_rig(encode: Any, moving: Any, lens_rig: Path) -> None:
    with refused(encode, moving, "the distortion model of its camera cam00 is not this rig's") as run:
        run(lens_rig)


def test_a_refusal_leaves_nothing(encode: Any, moving: Any, moving_rig: Path, tmp_path: Path) -> None:
    with refused(encode, moving, "held out") as run:
        run(moving_rig, holdout=[], output=tmp_path / "x.dgs")
    assert list(tmp_path.iterdir()) == []


def test_what_holds_no_keyframe_is_refused(moving: Any, tmp_path: Path) -> None:
    key = packets(moving.path)[PacketKind.KEY]
    (tmp_path / "header.dgs").write_bytes(moving.data[: key.offset])
    with pytest.raises(UsageError, match=r"`keyframe` .*header\.dgs: the stream has no frame; give one with at least"):
        read_keyframe(tmp_path / "header.dgs")
    with pytest.raises(UsageError, match=r"`keyframe` .*none\.dgs: No such file or directory; give the \.dgs file"):
        read_keyframe(tmp_path / "none.dgs")
    with pytest.raises(UsageError, match="Is a directory; give"):
        read_keyframe(tmp_path)
    damaged = bytearray(moving.data)
    damaged[key.offset + 100] ^= 1
    (tmp_path / "damaged.dgs").write_bytes(damaged)
    with pytest.raises(StreamError, match=r"damaged\.dgs: .*checksum"):
        read_keyframe(tmp_path / "damaged.dgs")


def test_a_refined_keyframe_is_the_same_scene_on_a_finer_lattice(moving: Any) -> None:
    source = read_keyframe(moving.path)
    finer = source.refined(8)
    assert finer.header.lattice.sh_dc == source.header.lattice.sh_dc / 8
    before, after = dequantise(source.state, source.header.lattice), dequantise(finer.state, finer.header.lattice)
    for name, array in vars(before).items():
        # Steps divided by a power of two: every value is exactly the same.
        np.testing.assert_array_equal(getattr(after, name), array)
    assert (finer.state.means == 8 * source.state.means.astype(np.int32)).all()
    np.testing.assert_array_equal(finer.state.ids, source.state.ids)
    with pytest.raises(UsageError, match="does not fit"):
        source.refined(1 << 30)
