"""``encode`` from Python: the command's options by the same names, and the same bytes as the loop alone."""

from __future__ import annotations

import io
import json
import math
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decogs.decoder import open_stream
from decogs.encoder import PRESETS, EncodeJob, Switches, Targets, TerminalProgress
from decogs.encoder.settings.effects import CAMERA_EFFECTS
from decogs.formats.errors import RigError, StreamError, UsageError
from decogs.formats.rigs import open_rig
from decogs.formats.stream.container import FRAME_KINDS, PacketKind
from encode_rig import encode_rig
from packets import iterate_packets


def test_same_bytes_as_the_loop_whatever_is_logged(
    moving: Any, moving_rig: Path, tiny_rig: Any, tiny_settings: Any, tmp_path: Path
) -> None:
    output, log = tmp_path / "scene.dgs", tmp_path / "log.jsonl"
    report = encode_rig(moving_rig, output, holdout=[tiny_rig.held_out], settings=tiny_settings, log=log)
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
        holdout=[tiny_rig.held_out],
        settings=tiny_settings,
        effects="auto",
        log=log,
        progress=TerminalProgress(screen),
    )
    look, start, *_ = (json.loads(line) for line in log.read_text().splitlines())
    assert look["event"] == "look"
    assert not {*CAMERA_EFFECTS} & look["detected"].keys()
    assert tiny_rig.held_out not in {name for names in look["detected"].values() for name in names}
    assert start["settings"]["detect_per_frame"] is True, "a frame may still bring what the clip did not show"
    assert "analysing" in screen.getvalue()
    assert "effects: " in screen.getvalue()
    with pytest.raises(UsageError, match="3dgstream has none of them"):
        encode_rig(still_rig, output, settings=tiny_settings, switches=Switches("3dgstream"), effects="auto")


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("threads", (1.5, "2", None, math.nan)),
        ("scale", ("0.5", None, [1], math.inf)),
        ("frames", ("0:2", 3, (0, 2), [0, 1], slice(0, 2.5), np.arange(3))),
        ("only", ("0:2", 3, slice("a"))),
        ("segment", ("2", 1.5, math.nan, 0)),
        ("holdout", (5, None, "cam00", [None])),
        ("targets", (5, {})),
        ("switches", (5, {})),
        ("max_memory", ("4G", 1.5, math.inf)),
        ("output", (None, 5, b"x.dgs")),
    ],
)
def test_what_a_parameter_does_not_take_is_named_before_anything_is_trained(
    moving_rig: Path, tiny_settings: Any, tmp_path: Path, name: str, values: tuple[Any, ...]
) -> None:
    settings = replace(tiny_settings, segment=2, closed=True) if name == "only" else tiny_settings
    for value in values:
        given = {"rig": moving_rig, "output": tmp_path / "x.dgs", "settings": settings} | {name: value}
        with pytest.raises(UsageError, match=f"^`{name}` "):
            encode_rig(**given)
    assert not list(tmp_path.glob("x.dgs*"))


class Screen(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_an_open_file_gets_the_same_bytes(moving: Any, moving_rig: Path, tiny_rig: Any, tiny_settings: Any) -> None:
    pipe = io.BytesIO()
    report = encode_rig(moving_rig, pipe, holdout=[tiny_rig.held_out], settings=tiny_settings, keyframe=moving.path)
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
    given = {"holdout": [tiny_rig.held_out], "settings": tiny_settings, "keyframe": moving.path}
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


def test_frames_as_range_and_as_slice_on_a_terminal_or_not(
    moving_rig: Path, tiny_settings: Any, tmp_path: Path
) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal = Terminal()
    first, second = tmp_path / "1.dgs", tmp_path / "2.dgs"
    with TerminalProgress(terminal) as progress:
        encode_rig(
            moving_rig, first, frames=range(1, 2), scale=0.5, settings=tiny_settings, threads=1, progress=progress
        )
    encode_rig(open_rig(moving_rig), str(second), tiny_settings, frames=slice(1, 2), scale=0.5)
    assert first.read_bytes() == second.read_bytes()
    assert "frame    1 key" in terminal.getvalue()


def test_every_option_of_the_command_has_its_parameter() -> None:
    parameters = {field.name for field in fields(EncodeJob)}
    parameters |= {field.name for options in (Switches, Targets) for field in fields(options)}
    assert {"frames", "scale", "holdout", "settings", "seed", "threads", "device", "max_memory", "log"} <= parameters
    assert {"method", "ablate", "selection", "effects", "keyframe", "segment", "resume"} <= parameters
    assert {"quality", "bytes_per_frame", "lossless", "time_budget", "target_psnr", "convergence_log"} <= parameters
    assert EncodeJob("rig", "scene.dgs").settings in PRESETS


@pytest.mark.parametrize("parts", [["focus", "gate"], ("gate", "focus", "gate")])
def test_switches_apply_on_top_of_the_preset(
    moving: Any, moving_rig: Path, tiny_rig: Any, tiny_settings: Any, tmp_path: Path, parts: Any
) -> None:
    given = {"settings": tiny_settings, "holdout": [tiny_rig.held_out], "keyframe": moving.path, "frames": slice(2)}
    encode_rig(moving_rig, tmp_path / "x.dgs", **given, switches=Switches(None, parts, "paper"), log=tmp_path / "log")
    start = json.loads((tmp_path / "log").read_text().splitlines()[0])
    assert start["keyframe"] == str(moving.path)
    expected = tiny_settings.as_document()
    expected["frame"] |= {"ablated": ["focus", "gate"]}
    expected["frame"]["selection"] |= {"rule": "paper"}
    assert start["settings"] == expected


@pytest.mark.usefixtures("brief_baseline")
def test_the_method_of_the_settings_holds_unless_another_is_asked_for(
    dense: Any, moving: Any, moving_rig: Path, tiny_rig: Any, tiny_settings: Any, tmp_path: Path
) -> None:
    given = {"holdout": [tiny_rig.held_out], "keyframe": moving.path}
    settings = replace(tiny_settings, method="3dgstream")
    for options, expected in (({}, dense), ({"switches": Switches("decogs")}, moving)):
        encode_rig(moving_rig, tmp_path / "x.dgs", settings=settings, **given, **options)
        assert (tmp_path / "x.dgs").read_bytes() == expected.data


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"device": "cuda"}, "`device` cuda: "),
        ({"device": "tpu"}, "`device` tpu: choose from auto, cpu, cuda"),
        ({"seed": -1}, "`seed` -1: give a number of at least 0"),
        ({"settings": "fast"}, "`settings` fast: there is no such preset"),
        ({"switches": Switches("dense")}, "`method` dense: there is no such method"),
        ({"switches": Switches(ablate=["select", "mask"])}, "`ablate` mask: there is no such part"),
        ({"switches": Switches("3dgstream", ["gate"])}, "`ablate` gate: `method` 3dgstream has no such part"),
        (
            {"switches": Switches(ablate=["select"], selection="weight")},
            "`selection` weight: `ablate` select takes every Gaussian",
        ),
        ({"keyframe": "no.dgs"}, "`keyframe` no.dgs: No such file or directory; give the .dgs file"),
        ({"segment": 0}, "`segment` 0: give a number of frames, at least 1"),
        ({"targets": Targets(quality=101)}, r"`quality` 101: give a number from 0 \(smallest\) to 100"),
        ({"targets": Targets(quality=float("nan"))}, "`quality` nan: give a number from 0"),
        (
            {"targets": Targets(quality=30, lossless=True)},
            "`lossless`: `quality` codes less than every change; drop one",
        ),
        ({"targets": Targets(bytes_per_frame=900, lossless=True)}, "`lossless`: `bytes_per_frame` codes less"),
        ({"targets": Targets(bytes_per_frame=0)}, "`bytes_per_frame` 0: that is 0 bytes a frame; give at least 1"),
        ({"targets": Targets(bytes_per_frame=float("inf"))}, "`bytes_per_frame` inf: that is inf bytes a frame"),
        (
            {"settings": "paper", "targets": Targets(bytes_per_frame=900)},
            "`bytes_per_frame` 900: these settings code every change; choose `settings` draft",
        ),
        (
            {"switches": Switches("3dgstream"), "targets": Targets(bytes_per_frame=900)},
            "`bytes_per_frame` 900: `method` 3dgstream codes every change; drop one",
        ),
        ({"targets": Targets(time_budget=0)}, r"`time_budget` 0: give from 0.0001 to 1e\+06 seconds a frame"),
        ({"targets": Targets(target_psnr=0)}, "`target_psnr` 0: give decibels above 0 and at most 100, such as 30"),
        ({"targets": Targets(target_psnr=float("nan"))}, "`target_psnr` nan: give decibels"),
        (
            {"switches": Switches("3dgstream"), "targets": Targets(time_budget=1)},
            "`time_budget`: `method` 3dgstream trains a fixed number of steps",
        ),
        ({"frames": slice(0, 4, 2)}, "`frames`: give consecutive frames, without a step"),
        ({"frames": range(7, 9)}, "`frames`: .* has frames 0 to 3; the range holds none of them"),
        ({"holdout": "cam01"}, r"`holdout` cam01: give a list of names, such as \['cam01'\]"),
        ({"threads": 5000}, "`threads` 5000"),
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
    with pytest.raises(UsageError, match="`resume`: a pipe cannot be resumed; name a file"):
        encode_rig(moving_rig, io.BytesIO(), settings=tiny_settings, resume=True)


def test_a_folder_that_is_no_rig_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RigError, match="no calibration"):
        encode_rig(tmp_path, tmp_path / "x.dgs")


def test_metrics_stand_behind_their_frames_and_change_nothing_else(
    moving: Any, moving_rig: Path, tiny_rig: Any, tiny_settings: Any, tmp_path: Path
) -> None:
    output = tmp_path / "told.dgs"
    options = {"holdout": [tiny_rig.held_out], "settings": tiny_settings}
    report = encode_rig(moving_rig, output, metrics=True, **options)
    packets = list(iterate_packets(io.BytesIO(output.read_bytes())))
    plain = list(iterate_packets(io.BytesIO(moving.data)))
    without = [packet for packet in packets if packet.kind != PacketKind.METRICS]
    kept = {PacketKind.HEADER, *FRAME_KINDS}
    assert [p.payload for p in without if p.kind in kept] == [p.payload for p in plain if p.kind in kept]
    assert [(p.kind, p.frame) for p in packets[1:-2]] == [
        pair for p in plain[1:-2] for pair in ((p.kind, p.frame), (PacketKind.METRICS, p.frame))
    ]
    told = [json.loads(packet.payload) for packet in packets if packet.kind == PacketKind.METRICS]
    assert told == [
        {"psnr": round(frame.training_psnr, 2), "held_out_psnr": round(frame.held_out_psnr, 2)}
        for frame in report.frames
    ]
    with open_stream(output) as stream:
        assert stream.frame_count == len(told)
