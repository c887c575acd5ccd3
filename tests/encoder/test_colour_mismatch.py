"""Cameras whose colours differ in every frame: found at first points, taken out, kept in the header, shown again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decogs.codec.packets.corrections import Correction, with_colours
from decogs.codec.scene.digest import digest
from decogs.decoder.cameras.corrections import apply_gain
from decogs.decoder.decoding import decode
from decogs.decoder.reading.info import info
from decogs.decoder.reading.stream import open_stream
from decogs.decoder.rendering.views import render_view
from decogs.encoder.input.compensation.colour import logit_shift
from decogs.encoder.input.compensation.matching import find_colours
from decogs.encoder.settings.effects import CorrectionSettings
from decogs.formats.cameras import in_picture, project
from decogs.formats.pictures.reading import read_picture
from decogs.formats.rigs import open_rig
from decogs.rig.pictures.ingest import Ingest

COLOURS = {
    "cam00": Correction(exposure=900),
    "cam01": Correction(exposure=-1400, red=200),
    "cam03": Correction(blue=-500),
    "cam04": Correction(),
}
"""Of the trained cameras; none is the median in all channels."""


def faults(name: str, frame: int) -> Correction:
    return COLOURS.get(name, Correction())


@pytest.fixture(scope="module")
def unlike_rig(tiny_rig: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny_rig.write(tmp_path_factory.mktemp("rigs") / "unlike", faults=faults)


@pytest.fixture(scope="module")
def settings(tiny_settings: Any) -> Any:
    return replace(tiny_settings, corrections=CorrectionSettings(match_colours=True))


@pytest.fixture(scope="module")
def matched(encode: Any, unlike_rig: Path, settings: Any) -> Any:
    return encode(unlike_rig, settings=settings)


def odds(correction: Correction) -> np.ndarray:
    return np.log(correction.odds_gain)


def without_common(found: dict[str, Correction]) -> np.ndarray:
    shifts = np.array([odds(found.get(name, Correction())) for name in COLOURS])
    return np.asarray(shifts - np.median(shifts, axis=0))


# What is found


def wall(rig: Path) -> tuple[Ingest, list[np.ndarray], np.ndarray, np.ndarray]:
    """The rig's first pictures, points on its rear wall away from the squares before it, and which views show them."""
    ingest = Ingest(open_rig(rig), holdout=["cam02"])
    pictures = next(iter(ingest.frames(0, 1))).training
    x, y = np.meshgrid(np.linspace(-0.9, 0.9, 61), [-0.75, -0.65, 0.6, 0.7])
    xyz = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.5)], axis=1).astype(np.float32)
    seen = np.stack([in_picture(view.pinhole, *project(view.pinhole, xyz)) for view in ingest.views])
    return ingest, pictures, xyz, seen


def test_differences_are_found_at_points_that_views_share(unlike_rig: Path) -> None:
    """To .05: the texture is a few pixels wide, and where cameras agree .016 is found."""
    ingest, pictures, xyz, seen = wall(unlike_rig)
    assert (seen.sum(axis=0) >= 3).sum() > 100
    found = find_colours(ingest.views, pictures, xyz, seen)
    np.testing.assert_allclose(without_common(dict(found)), without_common(COLOURS), atol=0.05)


def test_cameras_that_agree_are_left_alone(moving_rig: Path) -> None:
    """Two levels of 255 at mid-grey change the odds by .03; the texture is a few pixels wide."""
    ingest, pictures, xyz, seen = wall(moving_rig)
    found = find_colours(ingest.views, pictures, xyz, seen)
    assert np.abs([odds(correction) for correction in found.values()] or [[0.0]]).max() < 0.03


def test_a_camera_that_shares_too_little_has_no_difference(unlike_rig: Path) -> None:
    ingest, pictures, xyz, seen = wall(unlike_rig)
    alone = seen.copy()
    alone[1, 20:] = False
    assert "cam01" not in find_colours(ingest.views, pictures, xyz, alone)
    assert find_colours(ingest.views, pictures, xyz[:0], seen[:, :0]) == {}


# Whole encodes


def test_the_header_has_the_cameras_colours(matched: Any) -> None:
    """To .1 of a largest of .37: first points of 64 x 48 pixels lie up to half a pixel off."""
    with open_stream(matched.path) as stream:
        found = dict(stream.header.camera_colours)
        assert "colour_mismatch" in stream.header.effects
        assert not stream.header.corrected.effects
        assert all(not frame.corrections for frame in stream.frames())
    assert set(found) <= set(COLOURS)
    np.testing.assert_allclose(without_common(found), without_common(COLOURS), atol=0.1)
    assert "corrections" not in matched.report.frames[1].costs
    facts = info(matched.path).to_json()["header"]["cameras"]
    assert {camera["name"] for camera in facts if camera["corrected"] == ["colour_mismatch"]} == set(found)


def test_a_new_view_is_better_for_it(matched: Any, encode: Any, unlike_rig: Path, tiny_settings: Any) -> None:
    """By 1.1 dB where it trains and by .03 where it does not, in a crude scene of 22 dB."""
    blind = encode(unlike_rig, settings=tiny_settings, stop=1)
    assert matched.report.frames[0].training_psnr > blind.report.frames[0].training_psnr + 0.5
    assert matched.report.frames[0].held_out_psnr > blind.report.frames[0].held_out_psnr


def test_a_decoder_shows_what_a_camera_recorded_or_the_scene(matched: Any, unlike_rig: Path, tmp_path: Path) -> None:
    with open_stream(matched.path) as stream:
        header, frame = stream.header, next(stream.frames())
    for name in ("cam00", "cam01"):
        shown = {}
        for drift_free in (False, True):
            folder = tmp_path / f"{name}-{drift_free}"
            decode(matched.path, folder, view=name, drift_free=drift_free, frames=slice(1))
            shown[drift_free] = read_picture(next(folder.iterdir())).astype(np.float32) / 255
        plain = render_view(header, frame.splats, name).image
        np.testing.assert_allclose(shown[True], np.clip(plain, 0, 1), atol=0.51 / 255)
        recorded = apply_gain(plain, header.camera_colours[name].odds_gain)
        np.testing.assert_allclose(shown[False], np.clip(recorded, 0, 1), atol=0.51 / 255)
        video = read_picture(unlike_rig / name / "0000.png").astype(np.float32) / 255
        left = logit_shift(video.transpose(2, 0, 1), shown[False].transpose(2, 0, 1)).shift
        # A crude scene's whole picture is up to .11 off what shared points tell (test_corrections).
        assert np.abs(left).max() < 0.12


def test_colours_add_to_what_a_frame_tells() -> None:
    frame = Correction(exposure=5, red=-3, blue=2, yaw=7)
    assert with_colours(frame, Correction(exposure=100, red=10, blue=-1)) == Correction(105, 7, 1, yaw=7)


def test_bytes_do_not_depend_on_threads(matched: Any, encode: Any, unlike_rig: Path, settings: Any) -> None:
    assert encode(unlike_rig, settings=settings, threads=2).data == matched.data


@pytest.mark.parametrize("frames", [1, 2])
def test_resumed_encodes_have_the_bytes_of_whole_ones(
    matched: Any, encode: Any, unlike_rig: Path, settings: Any, tmp_path: Path, frames: int
) -> None:
    (tmp_path / "scene.dgs.part").write_bytes(matched.cut_off(frames, 7))
    resumed = encode(unlike_rig, settings=settings, output=tmp_path / "scene.dgs", resume=True)
    assert resumed.data == matched.data


def test_a_given_keyframe_brings_its_cameras_colours(
    matched: Any, encode: Any, unlike_rig: Path, settings: Any, tiny_settings: Any
) -> None:
    """Whatever the settings say: its scene was trained with them."""
    for chosen in (settings, tiny_settings):
        again = encode(unlike_rig, settings=chosen, keyframe=matched.path)
        with open_stream(again.path) as ours, open_stream(matched.path) as theirs:
            assert ours.header.camera_colours == theirs.header.camera_colours
            for one, other in zip(ours.frames(), theirs.frames(), strict=True):
                assert digest(one.state) == digest(other.state)


def test_a_stream_of_cameras_that_agree_says_nothing_of_colours(moving: Any) -> None:
    with open_stream(moving.path) as stream:
        assert not stream.header.camera_colours
        assert b"colours" not in stream.header.to_bytes()
