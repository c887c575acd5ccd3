"""The three commands and the functions behind them: what they write, print and return."""

from __future__ import annotations

import json
import os
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest

import decogs.decoder
from decogs.codec.scene.lattice import dequantise
from decogs.decoder import decode, export, info, render_view
from decogs.decoder.cameras.pose_file import read_free_cameras
from decogs.decoder.commands import decode_main, export_main, info_main
from decogs.decoder.output.exr import coverage, linear_light
from decogs.decoder.output.pictures import to_8bit
from decogs.decoder.rasterise.incremental_view import IncrementalView
from decogs.formats.cameras import Camera
from decogs.formats.errors import UsageError

POSE = {"width": 40, "height": 30, "fov_y": 60, "position": [0, 0, 0], "look_at": [0, 0, 2], "up": [0, -1, 0]}


def read_png(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[..., ::-1]


def expected_picture(stream, frame: int, view: str | Camera, **options) -> np.ndarray:
    """The encoder's own preview of the frame: the writer's state, dequantised, through the same function."""
    splats = dequantise(stream.states[frame], stream.header.lattice)
    return to_8bit(render_view(stream.header, splats, view, **options).image)


def fails(command, arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Runs a command that must fail, and returns its one line."""
    try:
        code = command(arguments)
    except SystemExit as error:
        code = error.code
    assert code == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    assert ": error: " in printed.err
    return printed.err


@pytest.mark.parametrize("view", ["cam00", "cam01", "wide"])
def test_decoded_pictures_equal_the_encoders_preview(small_stream, tmp_path: Path, view: str) -> None:
    assert decode_main([str(small_stream.path), "--view", view, "-o", str(tmp_path / "out")]) == 0
    assert sorted(os.listdir(tmp_path / "out")) == [f"{view}_{t:06d}.png" for t in range(8)]
    for t in range(8):
        picture = read_png(tmp_path / "out" / f"{view}_{t:06d}.png")
        np.testing.assert_array_equal(picture, expected_picture(small_stream, t, view))


def test_options_reach_the_picture(small_stream, tmp_path: Path) -> None:
    arguments = ["--view", "cam01", "--scale", "1.5", "--background", "1,0,0.5", "--undistorted", "--threads", "2"]
    assert decode_main([str(small_stream.path), *arguments, "--frames", "3:4", "-o", str(tmp_path / "x.png")]) == 0
    expected = expected_picture(small_stream, 3, "cam01", scale=1.5, background=(1.0, 0.0, 0.5), undistorted=True)
    assert expected.shape == (66, 90, 3)
    np.testing.assert_array_equal(read_png(tmp_path / "x.png"), expected)


@pytest.mark.parametrize(
    ("frames", "expected"),
    [("2:5", [2, 3, 4]), ("-2:", [6, 7]), (":-6", [0, 1]), ("6:100", [6, 7]), (":", list(range(8)))],
)
def test_frames_are_half_open_as_in_python(small_stream, tmp_path: Path, frames: str, expected: list[int]) -> None:
    assert decode_main([str(small_stream.path), "--view", "cam00", "--frames", frames, "-o", str(tmp_path / "o")]) == 0
    assert sorted(os.listdir(tmp_path / "o")) == [f"cam00_{t:06d}.png" for t in expected]


def test_a_free_camera_sees_the_scene(small_stream, tmp_path: Path) -> None:
    pose = tmp_path / "pose.json"
    pose.write_text(json.dumps(POSE))
    assert (
        decode_main([str(small_stream.path), "--camera", str(pose), "-o", str(tmp_path / "o"), "--frames", ":2"]) == 0
    )
    focal = 15 / np.tan(np.pi / 6)
    camera = Camera("camera", 40, 30, focal, focal, 20.0, 15.0, np.eye(4))
    for t in range(2):
        picture = read_png(tmp_path / "o" / f"camera_{t:06d}.png")
        np.testing.assert_array_equal(picture, expected_picture(small_stream, t, camera))


def test_a_camera_path_has_one_camera_per_frame_of_the_stream(small_stream, tmp_path: Path) -> None:
    path = [POSE | {"position": [t / 10, 0, 0], "look_at": [t / 10, 0, 2]} for t in range(7)]
    (tmp_path / "path.json").write_text(json.dumps(path))
    decode(small_stream.path, tmp_path / "o", camera=tmp_path / "path.json", frames=slice(5, 7))
    decode(small_stream.path, tmp_path / "all", camera=tmp_path / "path.json", frames=slice(7))
    one, two = (read_png(tmp_path / "o" / f"camera_{t:06d}.png") for t in (5, 6))
    assert (one != two).any(), "frame 6 skips, but its camera has moved on"
    np.testing.assert_array_equal(one, read_png(tmp_path / "all" / "camera_000005.png"))
    with pytest.raises(UsageError, match="7 cameras and none for frame 7"):
        decode(small_stream.path, tmp_path / "late", camera=tmp_path / "path.json")
    assert not (tmp_path / "late").exists()


def test_a_path_with_times_shows_their_frames(small_stream, tmp_path: Path) -> None:
    """Bullet time around frame 3, back to frame 1, slow on from there, and across a keyframe."""
    times = [3, 3, 3, 1, 1.25, 1.5, 1.75, 4.2, 0]
    entries = [POSE | {"position": [k / 20, 0, 0], "frame": time} for k, time in enumerate(times)]
    (tmp_path / "path.json").write_text(json.dumps(entries))
    report = decode(small_stream.path, tmp_path / "o", camera=tmp_path / "path.json")
    assert report.frame_count == len(times)
    cameras = read_free_cameras(tmp_path / "path.json").cameras
    for k, frame in enumerate([3, 3, 3, 1, 1, 2, 2, 4, 0]):
        picture = read_png(tmp_path / "o" / f"camera_{k:06d}.png")
        np.testing.assert_array_equal(picture, expected_picture(small_stream, frame, cameras[k]))
    decode(small_stream.path, tmp_path / "some", camera=tmp_path / "path.json", frames=slice(5, 7))
    assert sorted(os.listdir(tmp_path / "some")) == ["camera_000005.png", "camera_000006.png"]
    five = "camera_000005.png"
    np.testing.assert_array_equal(read_png(tmp_path / "some" / five), read_png(tmp_path / "o" / five))


def test_a_path_with_times_needs_the_whole_stream(small_stream, tmp_path: Path) -> None:
    (tmp_path / "path.json").write_text(json.dumps([POSE | {"frame": 0}]))
    with pytest.raises(UsageError, match=r"path\.json: has times of its own"):
        decode(small_stream.path, tmp_path / "o", camera=tmp_path / "path.json", follow=True)
    with pytest.raises(UsageError, match=r"path\.json: nothing to decode, it has pictures 0:1"):
        decode(small_stream.path, tmp_path / "o", camera=tmp_path / "path.json", frames=slice(1, 2))
    assert not (tmp_path / "o").exists()


def test_video_and_exr_show_the_same(small_stream, tmp_path: Path) -> None:
    assert decode_main([str(small_stream.path), "--view", "cam01", "-o", str(tmp_path / "x.mp4")]) == 0
    video = cv2.VideoCapture(str(tmp_path / "x.mp4"))
    assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(25)
    for t in range(8):
        picture = video.read()[1][..., ::-1]
        assert np.abs(picture.astype(float) - expected_picture(small_stream, t, "cam01")).mean() < 6
    assert not video.read()[0]
    video.release()
    assert (
        decode_main([str(small_stream.path), "--view", "cam01", "-o", str(tmp_path / "f_%04d.exr"), "--frames", "1:3"])
        == 0
    )
    rendering = render_view(
        small_stream.header, dequantise(small_stream.states[1], small_stream.header.lattice), "cam01"
    )
    with OpenEXR.File(str(tmp_path / "f_0001.exr"), separate_channels=True) as file:
        red, alpha = (np.array(file.channels()[name].pixels, np.float64) for name in "RA")
    covered = coverage(rendering.alpha)
    over = red + (1 - covered) * linear_light(np.array([small_stream.header.background[0]], np.float32))
    # Half precision of a colour below 1.
    np.testing.assert_allclose(over, linear_light(rendering.image[..., 0]), atol=2**-11)
    np.testing.assert_allclose(alpha, covered, atol=2**-11)


def test_an_unchanged_scene_is_not_rendered_twice(small_stream, tmp_path: Path, monkeypatch) -> None:
    drawn = []
    redraw = IncrementalView.redraw

    def counting(view: IncrementalView) -> int:
        drawn.append(redraw(view))
        return drawn[-1]

    monkeypatch.setattr(IncrementalView, "redraw", counting)
    decode(small_stream.path, tmp_path / "o", view="cam00")
    assert [tiles > 0 for tiles in drawn] == [kind != "skip" for kind in small_stream.kinds]


def test_decoding_an_unfinished_stream_warns(unfinished_stream, tmp_path: Path, capsys) -> None:
    assert decode_main([str(unfinished_stream.path), "--view", "cam00", "-o", str(tmp_path / "o")]) == 0
    assert len(os.listdir(tmp_path / "o")) == 7
    assert "warning" in (line := capsys.readouterr().err)
    assert "3 bytes into a packet; its 7 complete frames are read" in line


def test_export_writes_usd(small_stream, tmp_path: Path, capsys) -> None:
    from pxr import Usd

    assert export_main([str(small_stream.path), "-o", str(tmp_path / "s.usda"), "--frames", "1:4"]) == 0
    printed = capsys.readouterr().out
    assert "3 frames" in printed
    assert " file" not in printed, "it is one"
    assert export_main([str(small_stream.path), "-o", str(tmp_path / "s_%d.ply"), "--frames", "1:4"]) == 0
    assert "3 frames, 3 files, " in capsys.readouterr().out
    stage = Usd.Stage.Open(str(tmp_path / "s.usda"))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode(), stage.GetFramesPerSecond()) == (1, 3, 25)
    report = export(small_stream.path, tmp_path / "again.usdc", frames=slice(0, 2), up="Z")
    assert (report.frame_count, report.dynamic_count, report.static_count) == (2, 10, 50)


def test_info_counts_what_was_written(small_stream, capsys) -> None:
    assert info_main([str(small_stream.path), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert [frame["kind"] for frame in facts["frames"]] == list(small_stream.kinds)
    changes = [(frame["touched"], frame["added"], frame["removed"]) for frame in facts["frames"]]
    assert changes == list(small_stream.changes)
    assert [frame["gaussians"] for frame in facts["frames"]] == [len(state) for state in small_stream.states]
    totals = facts["totals"]
    size = small_stream.path.stat().st_size
    assert totals["file_bytes"] == sum(totals["bytes_by_purpose"].values()) == size
    assert totals["bytes_per_frame"] == size / 8
    later = [frame["bytes"] for frame in facts["frames"][1:]]
    assert totals["bytes_per_frame_without_first_key"] == sum(later) / 7
    assert totals["mean_delta_bytes"] == np.mean([f["bytes"] for f in facts["frames"] if f["kind"] == "delta"])
    assert facts["header"]["cameras"][1] == {
        "name": "cam01", "width": 60, "height": 44, "distortion_model": "opencv", "held_out": True, "corrected": [],
    }  # fmt: skip
    assert facts["header"]["lattice"]["means"] == list(small_stream.header.lattice.means)
    assert facts["header"]["lattice"]["sh_dc"] == small_stream.header.lattice.sh_dc
    assert (facts["complete"], facts["version"]) == (True, [1, 0])


def test_info_prints_a_table_without_terminal_commands(small_stream, unfinished_stream, capsys) -> None:
    assert info_main([str(small_stream.path)]) == 0
    printed = capsys.readouterr().out
    assert "8 (2 key, 3 delta, 3 skip) at 25 fps" in printed
    assert "cam01  60x44, opencv lens, held out" in printed
    assert "\x1b" not in printed
    assert "unfinished" not in printed
    assert info_main([str(unfinished_stream.path)]) == 0
    assert "no end packet, 3 bytes of an incomplete packet follow" in capsys.readouterr().out


def test_info_bytes_is_a_table_that_adds_up_to_the_file(segmented_stream, capsys) -> None:
    assert info_main([str(segmented_stream.path), "--bytes"]) == 0
    printed = capsys.readouterr().out.splitlines()
    widths = {len(line) for line in printed}
    assert len(widths) == 1, "columns are aligned"
    rows = {line[:14].strip(): [int(cell) for cell in line[14:].split()] for line in printed[1:]}
    frames = [cells for label, cells in rows.items() if label[0].isdigit()]
    assert "5 key*" in rows
    assert len(frames) == len(segmented_stream.states)
    size = segmented_stream.path.stat().st_size
    columns = list(zip(*frames, rows["around frames"], strict=True))
    assert [sum(column) for column in columns] == rows["the file"]
    assert all(sum(cells[:-1]) == cells[-1] for cells in frames)
    assert rows["the file"][-1] == size
    keys = [cells for label, cells in rows.items() if "key" in label and label[0].isdigit()]
    assert rows["mean of key"] == pytest.approx(np.mean(keys, axis=0), abs=0.5), "rounded to whole bytes"

    assert info_main([str(segmented_stream.path), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    table = facts["bytes"]
    assert table["frames"] == [cells[:-1] for cells in frames]
    for frame, cells in zip(facts["frames"], table["frames"], strict=True):
        by_name = dict(zip(table["purposes"], cells, strict=True))
        assert frame["bytes"] == sum(cells)
        assert frame["bytes_by_purpose"].items() <= by_name.items()
    assert table["purposes"][0] == "header"
    assert table["purposes"][-1] == "container"
    assert {"means", "index", "removed", "added.means"} <= set(table["purposes"])
    assert sum(table["totals"]) == size
    assert table["means"]["delta"] == pytest.approx(
        np.mean([c for f, c in zip(facts["frames"], table["frames"], strict=True) if f["kind"] == "delta"], axis=0)
    )


def test_info_tells_keyframes_that_refer_to_the_first(segmented_stream, capsys) -> None:
    assert info_main([str(segmented_stream.path), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert [f["index"] for f in facts["frames"] if f["refers_to_first"]] == [5, 10, 15]
    first, last = segmented_stream.states[0], segmented_stream.states[15]
    key = facts["frames"][15]
    assert (key["added"], key["removed"]) == (
        len(np.setdiff1d(last.ids, first.ids)),
        len(np.setdiff1d(first.ids, last.ids)),
    )
    assert 0 < key["touched"] < len(last)
    assert key["touched_fraction"] < facts["frames"][0]["touched_fraction"] == 1
    assert {"index", "removed", "added.means"} <= set(key["bytes_by_purpose"])
    assert info_main([str(segmented_stream.path)]) == 0
    printed = capsys.readouterr().out
    assert printed.count(" key* ") == 3
    assert "key*: coded as the difference from the first keyframe" in printed


def test_errors_are_one_line_and_exit_code_2(small_stream, tmp_path: Path, capsys) -> None:
    scene, out = str(small_stream.path), str(tmp_path / "o")
    (tmp_path / "file").write_text("x")
    broken = tmp_path / "broken.dgs"
    data = bytearray(small_stream.path.read_bytes())
    data[-400] ^= 1
    broken.write_bytes(data)
    for arguments, message in (
        ([scene, "--view", "cam9", "-o", out], "no camera 'cam9' in this stream; it has cam00, cam01, wide"),
        ([scene, "-o", out], "choose one view: a camera of the rig (cam00"),
        ([scene, "--view", "cam00"], "required: -o/--output"),
        ([scene, "--view", "cam00", "--camera", "x", "-o", out], "not allowed with"),
        ([scene, "--camera", str(tmp_path / "no.json"), "-o", out], "no.json: cannot be read"),
        ([scene, "--view", "cam00", "-o", out, "--frames", "8:9"], "nothing to decode, it has frames 0:8"),
        ([scene, "--view", "cam00", "-o", out, "--frames", "all"], "no range; write A:B"),
        ([scene, "--view", "cam00", "-o", out, "--scale", "0"], "scale of 0"),
        ([scene, "--view", "cam00", "-o", out, "--scale", "big"], "--scale: 'big' is no number"),
        ([scene, "--view", "cam00", "-o", out, "--background", "red"], "'red' is no colour"),
        ([scene, "--view", "cam00", "-o", out, "--background", "0,0,255"], "is no colour"),
        ([scene, "--view", "cam00", "-o", out, "--threads", "-1"], "no number of threads"),
        ([scene, "--view", "cam00", "-o", f"{out}.jpg"], ".jpg is not written"),
        ([scene, "--view", "cam00", "-o", str(tmp_path / "file" / "o")], "cannot be written"),
        ([str(tmp_path / "none.dgs"), "--view", "cam00", "-o", out], "none.dgs: No such file or directory"),
        ([str(tmp_path), "--view", "cam00", "-o", out], "Is a directory"),
        (
            [str(tmp_path / "file"), "--view", "cam00", "-o", out],
            "file: this is not a .dgs stream at byte 0 [bad-sig",
        ),
        ([str(broken), "--view", "cam00", "-o", out, "--strict"], "[bad-"),
        ([scene, "--view", "cam00", "-o", out, "--max-memory", "lots"], "'lots' is no size; write bytes, or"),
        ([scene, "--view", "cam00", "-o", out, "--max-memory", "0"], "'0' is no size"),
        ([scene, "--view", "cam00", "-o", out, "--max-memory", "1M", "--scale", "9"], "more memory (--max-memory)"),
    ):
        assert message in fails(decode_main, arguments, capsys), arguments
        assert sorted(os.listdir(tmp_path)) == ["broken.dgs", "file", "scene.dgs"]
    assert "[bad-" in fails(info_main, [str(broken), "--strict"], capsys)
    assert "[bad-" in fails(export_main, [str(broken), "-o", f"{out}.usda", "--strict"], capsys)
    assert "[too-" in fails(info_main, [scene, "--max-memory", "35K"], capsys)
    assert "required: stream" in fails(info_main, [], capsys)
    assert "o.obj" in fails(export_main, [scene, "-o", f"{out}.obj"], capsys)
    assert "nothing to decode" in fails(export_main, [scene, "-o", f"{out}.usda", "--frames", "5:5"], capsys)


def test_ctrl_c_is_one_line_and_leaves_nothing(small_stream, tmp_path: Path, capsys, monkeypatch) -> None:
    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("decogs.decoder.rendering.played_view.PlayedView.show", interrupted)
    assert decode_main([str(small_stream.path), "--view", "cam00", "-o", str(tmp_path / "o.mp4")]) == 130
    assert capsys.readouterr().err == "decogs-decode: interrupted\n"
    assert os.listdir(tmp_path) == ["scene.dgs"]


def test_a_short_job_tells_no_progress_without_a_terminal(small_stream, tmp_path: Path, capsys) -> None:
    assert decode_main([str(small_stream.path), "--view", "cam00", "-o", str(tmp_path / "o")]) == 0
    assert capsys.readouterr().err == ""


def test_functions_tell_of_progress_and_check_their_arguments(small_stream, tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    decode(small_stream.path, tmp_path / "o", view="cam00", on_frame=lambda *at: told.append(at))
    assert told == [(t + 1, 8) for t in range(8)]
    told.clear()
    info(small_stream.path, on_frame=lambda *at: told.append(at))
    assert told[-1] == (8, 8)
    for options, message in (
        ({}, "choose one view"),
        ({"view": "cam00", "camera": "x"}, "choose one view"),
        ({"camera": []}, "camera path is empty"),
        ({"view": "cam00", "frames": slice(0, 8, 2)}, "a step is not possible"),
    ):
        with pytest.raises(UsageError, match=message):
            decode(small_stream.path, tmp_path / "x", **options)
    export(small_stream.path, tmp_path / "s.usda")
    assert callable(decogs.decoder.export), "the function, not the submodule of that name"
