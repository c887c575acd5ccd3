"""``encode`` from Python: the command's options by the same names, and the same bytes as the loop alone."""

from __future__ import annotations

import inspect
import io
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from decogs.encoder import PRESETS
from decogs.encoder import encode as encode_rig
from decogs.formats.errors import RigError, StreamError, UsageError
from packets import iterate_packets


def test_same_bytes_as_the_loop_whatever_is_logged(
    moving: Any, moving_rig: Path, tiny_rig: Any, tiny_settings: Any, tmp_path: Path
) -> None:
    output, log = tmp_path / "scene.dgs", tmp_path / "log.jsonl"
    report = encode_rig(moving_rig, output, holdout=tiny_rig.held_out, preset=tiny_settings, log=log)
    assert output.read_bytes() == moving.data
    assert report.output == output
    records = [json.loads(line) for line in log.read_text().splitlines()]
    assert [record["event"] for record in records] == ["start", "frame", "frame", "frame", "frame", "end"]
    start, *frames, end = records
    assert start["cameras"] == list(tiny_rig.names)
    assert (start["held_out"], start["frames"], start["seed"]) == ([tiny_rig.held_out], [0, 4], 0)
    assert start["settings"] == json.loads(json.dumps(tiny_settings.as_document()))
    assert [frame["kind"] for frame in frames] == ["key", "delta", "skip", "delta"]
    for record, frame in zip(frames, report.frames, strict=True):
        for name in ("frame", "bytes", "gaussians", "selected", "training_psnr", "held_out_psnr", "seconds", "costs",
                     "cpu_seconds"):  # fmt: skip
            assert record[name] == getattr(frame, name)
    assert (end["output"], end["bytes"], end["interrupted"]) == (str(output), len(moving.data), False)


def test_auto_looks_at_the_rig_first_and_builds_what_it_calls_for(
    still_rig: Path, tiny_rig: Any, tiny_settings: Any, tmp_path: Path
) -> None:
    output, log, screen = tmp_path / "scene.dgs", tmp_path / "log.jsonl", Screen()
    encode_rig(
        still_rig,
        output,
        holdout=tiny_rig.held_out,
        preset=tiny_settings,
        effects="auto",
        log=log,
        terminal=screen,
    )
    look, start, *_ = (json.loads(line) for line in log.read_text().splitlines())
    assert look["event"] == "look"
    assert not {"motion", "appearance_change", "emergence", "disappearance"} & look["detected"].keys()
    assert tiny_rig.held_out not in {name for names in look["detected"].values() for name in names}
    assert start["settings"]["detect_per_frame"] is True, "a frame may still bring what the clip did not show"
    assert "looking" in screen.getvalue()
    assert "calls for " in screen.getvalue()
    with pytest.raises(UsageError, match="3dgstream has none of them"):
        encode_rig(still_rig, output, preset=tiny_settings, method="3dgstream", effects="auto")


class Screen(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_an_open_file_gets_the_same_bytes(moving: Any, moving_rig: Path, tiny_rig: Any, tiny_settings: Any) -> None:
    pipe = io.BytesIO()
    report = encode_rig(moving_rig, pipe, holdout=tiny_rig.held_out, preset=tiny_settings, keyframe=moving.path)
    assert pipe.getvalue() == moving.data
    assert (report.output, report.total_bytes) == (Path("-"), len(moving.data))


def test_a_pipe_interrupted_inside_a_packet_ends_there(
    moving: Any, moving_rig: Path, tiny_rig: Any, tiny_settings: Any
) -> None:
    class Torn(io.BytesIO):
        def __init__(self, share: float) -> None:
            super().__init__()
            self.share = share

        def write(self, data: Any) -> int:
            if self.tell() < len(whole) <= self.tell() + len(data):
                super().write(data[: int(self.share * len(data))])
                raise KeyboardInterrupt
            return super().write(data)

    packets = list(iterate_packets(io.BytesIO(moving.data)))
    whole = moving.data[: packets[2].offset + packets[2].size]
    given = {"holdout": tiny_rig.held_out, "preset": tiny_settings, "keyframe": moving.path}
    for share, frames, error in ((0.0, 1, None), (0.5, 1, "truncated")):
        pipe = Torn(share)
        report = encode_rig(moving_rig, pipe, **given)
        assert (report.interrupted, len(report.frames)) == (True, frames)
        left = list(iterate_packets(io.BytesIO(pipe.getvalue()), strict=False))
        assert left == packets[: len(left)]
        assert len(left) == 1 + frames
        if error:
            with pytest.raises(StreamError, match=error):
                list(iterate_packets(io.BytesIO(pipe.getvalue())))


def test_frames_as_text_and_as_slice_on_a_terminal_or_not(moving_rig: Path, tiny_settings: Any, tmp_path: Path) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal = Terminal()
    first, second = tmp_path / "1.dgs", tmp_path / "2.dgs"
    encode_rig(moving_rig, first, frames="1:2", scale=0.5, preset=tiny_settings, threads=1, terminal=terminal)
    encode_rig(str(moving_rig), str(second), frames=slice(1, 2), scale=0.5, preset=tiny_settings)
    assert first.read_bytes() == second.read_bytes()
    assert "frame    1 key" in terminal.getvalue()


def test_options_have_the_commands_names() -> None:
    options = set(inspect.signature(encode_rig).parameters)
    assert {"frames", "scale", "holdout", "preset", "seed", "threads", "device", "log"} <= options
    assert {"method", "ablate", "selection", "keyframe", "segment", "resume"} <= options
    assert {"quality", "bitrate", "max_mb_per_frame", "lossless"} <= options
    assert {"time_budget", "target_psnr", "convergence_log"} <= options
    assert inspect.signature(encode_rig).parameters["preset"].default in PRESETS


@pytest.mark.parametrize("parts", ["gate,focus", ["focus", "gate"], ["gate", "gate, focus"]])
def test_switches_apply_on_top_of_the_preset(
    moving: Any, moving_rig: Path, tiny_rig: Any, tiny_settings: Any, tmp_path: Path, parts: Any
) -> None:
    given = {"preset": tiny_settings, "holdout": tiny_rig.held_out, "keyframe": moving.path, "frames": ":2"}
    encode_rig(moving_rig, tmp_path / "x.dgs", **given, ablate=parts, selection="paper", log=tmp_path / "log")
    start = json.loads((tmp_path / "log").read_text().splitlines()[0])
    assert start["keyframe"] == str(moving.path)
    expected = tiny_settings.as_document()
    expected["frame"] |= {"ablated": ["focus", "gate"]}
    expected["frame"]["selection"] |= {"rule": "paper"}
    assert start["settings"] == expected


def test_the_method_of_the_settings_holds_unless_another_is_asked_for(
    dense: Any, moving: Any, moving_rig: Path, tiny_rig: Any, tiny_settings: Any, tmp_path: Path
) -> None:
    given = {"holdout": tiny_rig.held_out, "keyframe": moving.path}
    settings = replace(tiny_settings, method="3dgstream")
    for options, expected in (({}, dense), ({"method": "decogs"}, moving)):
        encode_rig(moving_rig, tmp_path / "x.dgs", preset=settings, **given, **options)
        assert (tmp_path / "x.dgs").read_bytes() == expected.data


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"device": "cuda"}, "--device cuda: "),
        ({"device": "tpu"}, "--device tpu: choose from auto, cpu, cuda"),
        ({"seed": -1}, "--seed -1: give a number of at least 0"),
        ({"preset": "fast"}, "--preset fast: there is no such preset"),
        ({"method": "dense"}, "--method dense: there is no such method"),
        ({"ablate": "select,mask"}, "--ablate mask: there is no such part"),
        ({"method": "3dgstream", "ablate": ["gate"]}, "--ablate gate: --method 3dgstream has no such part"),
        ({"ablate": "select", "selection": "weight"}, "--selection weight: --ablate select takes every Gaussian"),
        ({"keyframe": "no.dgs"}, "--keyframe no.dgs: No such file or directory; give the .dgs file"),
        ({"segment": 0}, "--segment 0: give a number of frames, at least 1"),
        ({"quality": 101}, r"--quality 101: give a number from 0 \(smallest\) to 100"),
        ({"quality": float("nan")}, "--quality nan: give a number from 0"),
        ({"quality": 30, "lossless": True}, "--lossless: --quality asks for less than everything; drop one"),
        ({"bitrate": 900, "lossless": True}, "--lossless: --bitrate asks for less"),
        ({"bitrate": 900, "max_mb_per_frame": 0.01}, "--bitrate and --max-mb-per-frame are one budget in two units"),
        ({"bitrate": 0}, "--bitrate 0: that is 0 bytes a frame; give at least 1"),
        ({"max_mb_per_frame": -1}, "--max-mb-per-frame -1: that is -1e[+]06 bytes a frame; give at least 1"),
        ({"max_mb_per_frame": float("inf")}, "--max-mb-per-frame inf: that is inf bytes a frame"),
        ({"preset": "paper", "bitrate": 900}, "--bitrate 900: these settings code every change; choose --preset draft"),
        ({"method": "3dgstream", "bitrate": 900}, "--bitrate 900: --method 3dgstream codes every change; drop one"),
        ({"time_budget": "soon"}, "--time-budget soon: that is no time; write 1.5s/frame"),
        ({"time_budget": 0}, "--time-budget 0: that is no time"),
        ({"target_psnr": 0}, "--target-psnr 0: give decibels above 0 and at most 100, such as 30"),
        ({"target_psnr": float("nan")}, "--target-psnr nan: give decibels"),
        ({"method": "3dgstream", "time_budget": 1}, "--time-budget: --method 3dgstream trains a fixed number of steps"),
        ({"frames": "1-2"}, "frames '1-2' are no range"),
        ({"threads": 5000}, "--threads 5000"),
    ],
)
def test_impossible_options_are_refused(
    moving_rig: Path, tmp_path: Path, options: dict[str, Any], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    with pytest.raises(UsageError, match=message):
        encode_rig(moving_rig, tmp_path / "x.dgs", **options)
    assert list(tmp_path.iterdir()) == []


def test_a_pipe_cannot_be_resumed(moving_rig: Path, tiny_settings: Any) -> None:
    with pytest.raises(UsageError, match="--resume: a pipe cannot be gone on with; name a file"):
        encode_rig(moving_rig, io.BytesIO(), preset=tiny_settings, resume=True)


def test_a_folder_that_is_no_rig_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RigError, match="no calibration"):
        encode_rig(tmp_path, tmp_path / "x.dgs")
