"""What the user sees: a bar on a terminal, lines in a pipe, and every figure in the log."""

from __future__ import annotations

import io
import json
import math
from dataclasses import asdict, fields, replace
from pathlib import Path

import pytest

from decogs.encoder import FrameReport
from decogs.encoder.output.encode_log import EncodeLog
from decogs.encoder.output.observer import EncodeObserver
from decogs.encoder.output.progress import TerminalProgress, frame_line
from decogs.formats.cli.progress import Pace
from decogs.formats.errors import UsageError


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def follow(observer: EncodeLog | TerminalProgress, report: FrameReport) -> None:
    with observer as progress:
        progress.started({"frames": [2, 4]})
        for step in range(1, 101):
            progress.keyframe_step(step, 100, 0.5 / step)
        progress.frame(replace(report, frame=2, kind="key", held_out_psnr=None))
        progress.frame(report)
        progress.finished({"bytes": 5})


def test_a_pipe_gets_nothing_of_a_short_encode(frame_report: FrameReport) -> None:
    pipe = io.StringIO()
    follow(TerminalProgress(pipe), frame_report)
    assert pipe.getvalue() == ""


EVERY_TENTH = Pace(math.inf, pause=0.0)


def test_a_pipe_gets_lines_of_keyframe_and_frames(frame_report: FrameReport) -> None:
    pipe = io.StringIO()
    follow(TerminalProgress(pipe, pace=EVERY_TENTH), frame_report)
    lines = pipe.getvalue().splitlines()
    assert len([line for line in lines if line.startswith("keyframe: ")]) == 10, "every tenth of 100 steps"
    assert lines[-2].startswith("frames: 1 of 2 frames, 0:00 elapsed, about 0:00 left")
    assert lines[-1] == "frames: 2 of 2 frames, 0:00 elapsed"


def test_of_a_recording_that_goes_on_nobody_knows_the_end(frame_report: FrameReport) -> None:
    pipe = io.StringIO()
    follow(TerminalProgress(pipe, endless=True, pace=Pace(0.0, 0.0)), frame_report)
    assert pipe.getvalue().splitlines()[-1] == "frames: 2 frames, 0:00 elapsed"


def test_the_first_keyframe_is_none_of_the_frames_of_a_later_part(frame_report: FrameReport) -> None:
    pipe = io.StringIO()
    with TerminalProgress(pipe, pace=EVERY_TENTH) as progress:
        progress.started({"frames": [2, 4]})
        for frame in (0, 2, 3):
            progress.frame(replace(frame_report, frame=frame))
    assert pipe.getvalue().splitlines()[-1] == "frames: 2 of 2 frames, 0:00 elapsed"


def test_nobody_need_listen(frame_report: FrameReport, capfd: pytest.CaptureFixture[str]) -> None:
    follow(TerminalProgress(None), frame_report)
    assert capfd.readouterr() == ("", "")


def test_an_observer_may_do_nothing(frame_report: FrameReport, capfd: pytest.CaptureFixture[str]) -> None:
    observer = EncodeObserver()
    observer.look_step(1, 2)
    observer.looked({"motion": ["cam01"]})
    observer.started({"frames": [0, 2]})
    observer.keyframe_step(1, 100, 0.5)
    observer.frame(frame_report)
    observer.finished({"bytes": 5})
    assert capfd.readouterr() == ("", "")


def test_a_terminal_gets_two_bars_with_the_time_left_and_a_line_per_frame(frame_report: FrameReport) -> None:
    terminal = Terminal()
    follow(TerminalProgress(terminal), frame_report)
    shown = terminal.getvalue()
    assert "keyframe:" in shown
    assert "/100 [" in shown
    assert "frames:" in shown
    assert "/2 [" in shown
    assert "<" in shown.split("frames:")[-1], "tqdm writes elapsed<left"
    lines = [line.rsplit("\r", 1)[-1] for line in shown.split("\n")]
    assert frame_line(frame_report) in lines
    assert shown.rstrip(" ").endswith("\r"), "the bars are wiped when all is done"


def test_later_keyframes_open_no_bar_and_replayed_frames_are_told(frame_report: FrameReport) -> None:
    terminal = Terminal()
    with TerminalProgress(terminal) as progress:
        progress.started({"frames": [4, 7]})
        for frame in range(4, 7):
            progress.frame(replace(frame_report, frame=frame, kind="key", replayed=frame < 6))
    shown = terminal.getvalue()
    assert "2/3 [" in shown, "one bar counts all of them"
    assert shown.count("replayed") == 2


def test_the_keyframe_of_another_scene_leaves_the_bar_of_frames_where_it_is(frame_report: FrameReport) -> None:
    terminal = Terminal()
    with TerminalProgress(terminal) as progress:
        progress.started({"frames": [0, 3]})
        progress.keyframe_step(100, 100, 0.5)
        progress.frame(replace(frame_report, frame=0, kind="key"))
        for step in range(1, 101):
            progress.keyframe_step(step, 100, 0.5)
        progress.frame(replace(frame_report, frame=1, kind="key", cut=True))
    shown = terminal.getvalue()
    assert "keyframe of another scene 1/100" in shown
    assert "100/3" not in shown
    assert "1/3 [" in shown.split("keyframe of another scene")[1], "no step of it is a frame"
    assert "  another scene" in shown, "and the frame's line says what it is"


def test_leaving_early_wipes_the_bar() -> None:
    terminal = Terminal()
    with TerminalProgress(terminal) as progress:
        progress.keyframe_step(1, 100, 0.5)  # and then the block is left
    assert terminal.getvalue().rstrip(" ").endswith("\r")


def test_a_frames_figures_on_one_line(frame_report: FrameReport) -> None:
    assert frame_line(frame_report) == (
        "frame    3 delta  train  31.50 dB  held out  30.25 dB  selected   6.2%      1234 bytes  "
        "masks 0.10 s  training 1.50 s"
    )
    assert "held out" not in frame_line(replace(frame_report, held_out_psnr=None))


def test_the_log_holds_one_json_object_per_event(frame_report: FrameReport, tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    follow(EncodeLog(path), frame_report)
    records = [json.loads(line) for line in path.read_text().splitlines()]
    assert [record.pop("event") for record in records] == ["start", "frame", "frame", "end"]
    assert records[0] == {"frames": [2, 4]}
    elapsed = [record.pop("elapsed") for record in records[1:]]
    assert elapsed == sorted(elapsed)
    assert records[2] == asdict(frame_report)
    assert set(records[2]) == {field.name for field in fields(FrameReport)} == {
        "frame", "kind", "bytes", "gaussians", "selected", "training_psnr", "held_out_psnr", "seconds", "costs",
        "cpu_seconds", "replayed", "effects", "left_out", "dropped", "rejected", "uncorrected", "full_frame_change",
        "cut", "scale", "held_out_own_size_psnr", "recorded",
    }  # fmt: skip
    assert records[1]["held_out_psnr"] is None
    assert records[3] == {"bytes": 5}


def test_the_log_can_be_followed_while_it_grows(frame_report: FrameReport, tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    with EncodeLog(path) as progress:
        progress.frame(frame_report)
        assert json.loads(path.read_text())["frame"] == 3


def test_a_log_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"`log` .*x/log\.jsonl: No such file or directory; name a file"):
        EncodeLog(tmp_path / "x" / "log.jsonl")
