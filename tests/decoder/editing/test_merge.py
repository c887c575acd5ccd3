"""Two takes in one scene: both are there to the bit on one lattice, ids apart, cameras and corrections of both."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from decogs.decoder.editing import Concat, Crop, Merge, Sphere, Transform, Trim, edit
from decogs.decoder.editing.commands import edit_main
from decogs.decoder.reading.stream import open_stream
from decogs.decoder.rendering.views import render_view
from decogs.formats.errors import UsageError
from edited_streams import bodies, header_of, in_order_of_values, states_of


def values(state) -> list[bytes]:
    columns = [getattr(state, name).reshape(len(state), -1).astype("<i4") for name in ("means", "log_scales", "sh")]
    return sorted(row.tobytes() for row in np.concatenate(columns, axis=1))


@pytest.mark.parametrize(("one", "other"), [("small_stream", "segmented_stream"), ("segmented_stream", "small_stream")])
def test_both_are_there_to_the_bit_for_as_long_as_both_last(one: str, other: str, request, tmp_path: Path) -> None:
    first, second = request.getfixturevalue(one).path, request.getfixturevalue(other).path
    out = tmp_path / "out.dgs"
    edit(first, out, [Merge(second)])
    merged, states, others = states_of(out), states_of(first), states_of(second)
    assert len(merged) == 8
    for now, a, b in zip(merged, states, others, strict=False):
        assert values(now) == sorted(values(a) + values(b))
    ours = {name for state in states for name, _ in in_order_of_values(state)}
    owner: dict[int, bool] = {}
    for state in merged:
        for row, name in in_order_of_values(state):
            assert owner.setdefault(name, row in ours) == (row in ours)


def test_three_takes(small_stream, tmp_path: Path) -> None:
    path = small_stream.path
    edit(path, tmp_path / "out.dgs", [Merge(path), Merge(path), Trim(slice(2, 7)), Concat((path,))])
    merged, states = states_of(tmp_path / "out.dgs"), states_of(path)
    for now, was in zip(merged[:5], states[2:7], strict=True):
        assert values(now) == sorted(values(was) * 3)
    assert [values(state) for state in merged[5:]] == [values(state) for state in states]


def test_what_does_not_move_costs_nothing(small_stream, tmp_path: Path) -> None:
    edit(small_stream.path, tmp_path / "out.dgs", [Merge(small_stream.path)])
    kinds = [kind for kind, _ in bodies(tmp_path / "out.dgs")]
    assert kinds == [kind for kind, _ in bodies(small_stream.path)]


def test_each_is_where_its_transform_says(small_stream, tmp_path: Path) -> None:
    edit(small_stream.path, tmp_path / "moved.dgs", [Transform(shift=(0.5, 0.1, 0.2), turns=(("Y", 180.0),))])
    for first, second in (("scene", "moved"), ("moved", "scene")):
        edit(tmp_path / f"{first}.dgs", tmp_path / "out.dgs", [Merge(tmp_path / f"{second}.dgs")])
        with (
            open_stream(tmp_path / "out.dgs") as merged,
            open_stream(tmp_path / f"{first}.dgs") as one,
            open_stream(tmp_path / f"{second}.dgs") as other,
        ):
            step = merged.header.lattice.means[0]
            now, a, b = (next(stream.frames()).splats.means for stream in (merged, one, other))
            distances = np.abs(now[:, None] - np.concatenate([a, b])[None]).max(axis=2)
            # Half a step, and float32.
            assert distances.min(axis=1).max() < step / 2 + 1e-6
            assert distances.min(axis=0).max() < step / 2 + 1e-6
            views = {camera.name: camera for camera in merged.header.cameras}
            assert {"cam00", "cam00_2"} <= set(views)
            np.testing.assert_allclose(
                views["cam00_2"].world_to_camera, other.header.cameras[0].world_to_camera, atol=1e-12
            )


def test_an_image_of_both_is_one_before_the_other(small_stream, tmp_path: Path) -> None:
    """A take far to the side, seen by the cameras that came with it, looks as it did alone."""
    edit(small_stream.path, tmp_path / "far.dgs", [Transform(shift=(50.0, 0, 0))])
    edit(small_stream.path, tmp_path / "out.dgs", [Merge(tmp_path / "far.dgs")])
    with open_stream(tmp_path / "out.dgs") as merged, open_stream(small_stream.path) as alone:
        now, was = next(merged.frames()), next(alone.frames())
        for name in ("cam00", "cam00_2"):
            seen = render_view(merged.header, now.splats, name).image
            expected = render_view(alone.header, was.splats, "cam00").image
            # Positions rounded by half a step of 2 units / 5500, at 60 pixels a unit: a hundredth of a pixel.
            assert np.abs(seen - expected).mean() < 1e-3


def test_a_crop_behind_a_merge_takes_of_both(small_stream, tmp_path: Path) -> None:
    region = Sphere((0.1, 0, 2.0), 0.4501)
    edit(small_stream.path, tmp_path / "out.dgs", [Merge(small_stream.path), Crop(region)])
    edit(small_stream.path, tmp_path / "once.dgs", [Crop(region)])
    for now, was in zip(states_of(tmp_path / "out.dgs"), states_of(tmp_path / "once.dgs"), strict=True):
        assert values(now) == sorted(values(was) * 2)


def test_what_does_not_go_together_is_refused(small_stream, tmp_path: Path) -> None:
    data = small_stream.path.read_bytes()
    header = header_of(small_stream.path)
    changed = replace(header, fps=24.0).to_bytes()
    assert len(changed) == len(header.to_bytes())
    with pytest.raises(UsageError, match="merge: one has 25 frames a second, the other 24"):
        edit(small_stream.path, None, [Merge(with_header(data, changed, tmp_path / "other.dgs"))])
    assert edit_main([str(small_stream.path), "--dry-run", "merge", str(tmp_path / "none.dgs")]) == 2


def with_header(data: bytes, header: bytes, path: Path) -> Path:
    from decogs.formats.stream.container import PacketKind, packet_bytes, prologue

    packet = packet_bytes(PacketKind.HEADER, 0, header)
    path.write_bytes(prologue() + packet + data[16 + len(packet) :])
    return path
