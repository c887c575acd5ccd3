"""``--resume``: the finished file has the bytes of an encode that was never cut off, wherever it was cut."""

from __future__ import annotations

import io
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.corrections import Correction
from decogs.encoder import Switches, Targets
from decogs.encoder.stopwatch import Stopwatch
from decogs.encoder.stream.frame_report import FrameReporter
from decogs.formats.errors import DecogsError, UsageError
from decogs.formats.stream.container import FRAME_KINDS, StreamWriter
from decogs.rig.pictures.ingest import RigFrame
from encode_rig import encode_rig
from packets import iterate_packets


def never(*_: Any, **__: Any) -> None:
    raise AssertionError("this was done already")


def ends(path: Path) -> list[int]:
    """Stream offsets behind each packet of a whole stream: header, frames, index, end."""
    with path.open("rb") as file:
        return [packet.offset + packet.size for packet in iterate_packets(file)]


def part(folder: Path, data: bytes) -> Path:
    """The output to resume, beside whose name ``data`` was left."""
    (folder / "scene.dgs.part").write_bytes(data)
    return folder / "scene.dgs"


# Where it was cut


@pytest.mark.parametrize("frames", [1, 2, 3, 4])
@pytest.mark.parametrize("more", [0, 1, 30])
def test_the_bytes_are_those_of_an_uninterrupted_encode(
    encode: Any, moving: Any, moving_rig: Path, tmp_path: Path, frames: int, more: int
) -> None:
    output = part(tmp_path, moving.data[: ends(moving.path)[frames] + more])
    resumed = encode(moving_rig, output=output, resume=True, on_keyframe_step=never)
    assert resumed.data == moving.data
    assert [path.name for path in tmp_path.iterdir()] == ["scene.dgs"]
    assert resumed.report.resumed == frames
    assert [frame.replayed for frame in resumed.report.frames] == [index < frames for index in range(4)]
    assert not any(frame.effects for frame in resumed.report.frames[:frames]), "nothing is trained"
    for ours, theirs in zip(resumed.report.frames, moving.report.frames, strict=True):
        for name in ("frame", "kind", "bytes", "gaussians", "selected", "training_psnr", "held_out_psnr", "costs"):
            assert getattr(ours, name) == getattr(theirs, name)


@pytest.mark.parametrize(
    "options",
    [
        {"switches": Switches("paper")},
        {"switches": Switches(ablate=["select", "focus"])},
        {"scale": 0.5},
        {"targets": Targets(lossless=True)},
        {"targets": Targets(60)},
        {"targets": Targets(target_psnr=24.0)},
        {"effects": "all"},
    ],
    ids=["paper", "ablated", "scale", "lossless", "quality", "target", "effects"],
)
def test_whatever_was_asked_for(moving_rig: Path, tiny_settings: Any, tmp_path: Path, options: dict[str, Any]) -> None:
    given = {"settings": tiny_settings, "holdout": ["cam02"], "threads": 1} | options
    encode_rig(moving_rig, tmp_path / "whole.dgs", **given)
    output = part(tmp_path, (tmp_path / "whole.dgs").read_bytes()[: ends(tmp_path / "whole.dgs")[2] + 9])
    assert encode_rig(moving_rig, output, resume=True, **given).resumed == 2
    assert output.read_bytes() == (tmp_path / "whole.dgs").read_bytes()


@pytest.mark.parametrize("at", [1, 2, 3, 6])
def test_figures_of_each_frame_are_resumed(
    moving: Any, moving_rig: Path, tiny_settings: Any, tmp_path: Path, at: int
) -> None:
    """Cut off behind a frame or its figures; what is left without any is no beginning of a stream that has them."""
    given = {"settings": tiny_settings, "holdout": ["cam02"], "keyframe": moving.path}
    for metrics in (True, False):
        whole = tmp_path / f"{metrics}.dgs"
        encode_rig(moving_rig, whole, metrics=metrics, **given)
        left = whole.read_bytes()[: ends(whole)[at if metrics else at // 2 + at % 2] + 5]
        output = part(tmp_path, left)
        assert encode_rig(moving_rig, output, metrics=metrics, resume=True, **given).resumed == at // 2 + at % 2
        assert output.read_bytes() == whole.read_bytes()
        output.unlink()
        output = part(tmp_path, left)
        if at < 3:  # only a keyframe, behind which all is written again
            encode_rig(moving_rig, output, metrics=not metrics, resume=True, **given)
            output.unlink()
        else:
            with pytest.raises(UsageError, match=f"begun {'with' if metrics else 'without'} `metrics`; give the same"):
                encode_rig(moving_rig, output, metrics=not metrics, resume=True, **given)
            output.with_name("scene.dgs.part").unlink()


def test_frames_that_are_there_are_not_trained_again(
    encode: Any, moving: Any, moving_rig: Path, tmp_path: Path
) -> None:
    output = part(tmp_path, moving.data[: ends(moving.path)[4]])
    resumed = encode(moving_rig, output=output, resume=True, on_keyframe_step=never)
    assert resumed.data == moving.data
    assert "training" in moving.report.frames[1].seconds
    assert not any("training" in frame.seconds for frame in resumed.report.frames)


@pytest.mark.parametrize("size", [0, 7, 200, -1])
def test_without_a_whole_keyframe_it_starts_over(
    encode: Any, moving: Any, moving_rig: Path, tmp_path: Path, size: int
) -> None:
    data = moving.data[: ends(moving.path)[1] - 1 if size < 0 else size]
    resumed = encode(moving_rig, output=part(tmp_path, data), resume=True)
    assert resumed.data == moving.data
    assert resumed.report.resumed == 0


def test_there_need_be_nothing_to_resume(encode: Any, moving: Any, moving_rig: Path, tmp_path: Path) -> None:
    resumed = encode(moving_rig, output=tmp_path / "scene.dgs", resume=True)
    assert (resumed.data, resumed.report.resumed) == (moving.data, 0)


def test_damage_is_encoded_again(encode: Any, moving: Any, moving_rig: Path, tmp_path: Path) -> None:
    """A power cut can leave more than a short packet."""
    data = bytearray(moving.data)
    data[ends(moving.path)[2] + 25] ^= 1
    resumed = encode(moving_rig, output=part(tmp_path, data), resume=True, on_keyframe_step=never)
    assert (resumed.data, resumed.report.resumed) == (moving.data, 2)


def test_the_dense_baseline_resumes(
    encode: Any, dense: Any, moving: Any, moving_rig: Path, tmp_path: Path, tiny_settings: Any
) -> None:
    output = part(tmp_path, dense.data[: ends(dense.path)[2] + 9])
    given = {"settings": replace(tiny_settings, method="3dgstream"), "keyframe": moving.path}
    assert encode(moving_rig, output=output, resume=True, **given).data == dense.data


def test_what_masks_remember_is_replayed(
    encode: Any, moving: Any, moving_rig: Path, tmp_path: Path, tiny_settings: Any
) -> None:
    frame = replace(
        tiny_settings.frame,
        masks=replace(tiny_settings.frame.masks, since_trained=True),
        joint_iterations=20,
    )
    given = {"settings": replace(tiny_settings, frame=frame, segment=2), "keyframe": moving.path}
    whole = encode(moving_rig, **given)
    for frames in (1, 2, 3):
        output = part(tmp_path, whole.data[: ends(whole.path)[frames] + 5])
        assert encode(moving_rig, output=output, resume=True, **given).data == whole.data


def test_which_effects_a_frame_called_for_is_replayed(
    encode: Any, moving: Any, tiny_rig: Any, tmp_path: Path, tiny_settings: Any
) -> None:
    """Light goes on in frame 1, and grows faintly: what masks take for a change then depends on it."""

    def lit(name: str, frame: int) -> Correction:
        return Correction(exposure=(0, 300, 800, 1300)[frame])

    rig = tiny_rig.write(tmp_path / "rig", frames=[0] * 4, faults=lit)
    masks = replace(tiny_settings.frame.masks, threshold=14.0, since_trained=True, light_threshold=4.0)
    settings = replace(tiny_settings, detect_per_frame=True, frame=replace(tiny_settings.frame, masks=masks))
    given = {"settings": settings, "keyframe": moving.path}
    whole = encode(rig, **given)
    assert [frame.effects for frame in whole.report.frames[1:]] == [["appearance_change"]] * 3
    unaware = replace(settings, frame=replace(settings.frame, masks=replace(masks, light_threshold=0.0)))
    assert encode(rig, settings=unaware, keyframe=moving.path).report.frames[2].kind == "skip"
    for frames in (2, 3):
        output = part(tmp_path, whole.data[: ends(whole.path)[frames] + 5])
        assert encode(rig, output=output, resume=True, **given).data == whole.data


# Under the stream's own name


def test_a_stream_that_ctrl_c_ended_is_gone_on_with(encode: Any, moving: Any, moving_rig: Path, tmp_path: Path) -> None:
    def interrupt(report: Any) -> None:
        if report.frame == 2:
            raise KeyboardInterrupt

    output = tmp_path / "scene.dgs"
    assert encode(moving_rig, output=output, on_frame=interrupt).report.interrupted
    resumed = encode(moving_rig, output=output, resume=True, on_keyframe_step=never)
    assert (resumed.data, resumed.report.resumed) == (moving.data, 3)
    assert [path.name for path in tmp_path.iterdir()] == ["scene.dgs"]


def test_a_whole_stream_is_left_as_it_is(encode: Any, moving: Any, moving_rig: Path, tmp_path: Path) -> None:
    output = tmp_path / "scene.dgs"
    output.write_bytes(moving.data)
    report = encode(moving_rig, output=output, resume=True, on_keyframe_step=never, on_frame=never).report
    assert (report.frames, report.resumed, report.total_bytes) == ([], 4, len(moving.data))
    assert output.read_bytes() == moving.data


def test_a_stream_that_only_lacks_its_end_gets_it(encode: Any, moving: Any, moving_rig: Path, tmp_path: Path) -> None:
    """As a copy that was cut off lacks it: all frames are there."""
    output = tmp_path / "scene.dgs"
    output.write_bytes(moving.data[: ends(moving.path)[4]])
    resumed = encode(moving_rig, output=output, resume=True, on_keyframe_step=never)
    assert (resumed.data, resumed.report.resumed) == (moving.data, 4)


def test_more_frames_can_be_added(encode: Any, moving: Any, moving_rig: Path, tmp_path: Path) -> None:
    output = tmp_path / "scene.dgs"
    encode(moving_rig, output=output, stop=2)
    assert encode(moving_rig, output=output, resume=True, on_keyframe_step=never).data == moving.data


# What does not fit


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": 3}, r"scene\.dgs\.part was begun with seed 0, this encode has 3; give the same options, or drop"),
        ({"holdout": ["cam03"]}, r"was begun with held_out \[\"cam02\"\], this encode has \[\"cam03\"\]"),
        ({"scale": 0.5}, "was begun with scale 1.0, this encode has 0.5"),
        ({"frames": slice(1, 4)}, "was begun with first_frame 0, this encode has 1"),
        ({"frames": slice(1)}, "already holds 2 frames, this encode has 1"),
        ({"segment": 2}, "was begun with segment 0, this encode has 2"),
        ({"switches": Switches("3dgstream")}, 'was begun with method "decogs", this encode has "3dgstream"'),
        (
            {"switches": Switches(selection="paper")},
            'was begun with frame.selection.rule "weight", this encode has "paper"',
        ),
        ({"targets": Targets(51)}, r"was begun with lattice_scale .*\(`quality`\); give the same options"),
        (
            {"switches": Switches(ablate=["gate"])},
            "`resume`: `ablate` gate keeps training state that a stream does not hold",
        ),
    ],
)
def test_other_options_are_refused_and_nothing_is_touched(
    moving: Any, moving_rig: Path, tiny_settings: Any, tmp_path: Path, options: dict[str, Any], message: str
) -> None:
    data = moving.data[: ends(moving.path)[2] + 7]
    output = part(tmp_path, data)
    with pytest.raises(UsageError, match=message) as raised:
        encode_rig(moving_rig, output, resume=True, **({"settings": tiny_settings, "holdout": ["cam02"]} | options))
    assert "\n" not in str(raised.value)
    assert [path.name for path in tmp_path.iterdir()] == ["scene.dgs.part"]
    assert (tmp_path / "scene.dgs.part").read_bytes() == data


@pytest.mark.parametrize("former", ["frame.cache_iterations", "keyframe.rates", "zstd_level", "cuts"])
def test_settings_of_another_release_are_refused(
    moving: Any, moving_rig: Path, tiny_settings: Any, tmp_path: Path, former: str
) -> None:
    """What is a constant now was a setting in earlier commits."""
    with moving.path.open("rb") as file:
        header, *frames = list(iterate_packets(file))[:3]
    document = json.loads(header.payload)
    group, name = former.rpartition(".")[::2]
    (document["settings"][group] if group else document["settings"])[name] = 150
    earlier = io.BytesIO()
    stream = StreamWriter(earlier, json.dumps(document).encode())
    for packet in frames:
        stream.write(packet.kind, packet.frame, packet.payload)
    output = part(tmp_path, earlier.getvalue())
    with pytest.raises(UsageError, match=f"was begun by another release of decogs: this one has no setting {former}"):
        encode_rig(moving_rig, output, resume=True, settings=tiny_settings, holdout=["cam02"])


def test_another_keyframe_is_refused(
    encode: Any, moving: Any, moving_rig: Path, tiny_settings: Any, tmp_path: Path
) -> None:
    output = part(tmp_path, moving.data[: ends(moving.path)[2]])
    other = replace(tiny_settings, keyframe=replace(tiny_settings.keyframe, iterations=60))
    keyframe = encode(moving_rig, settings=other, stop=1).path
    with pytest.raises(UsageError, match=r"scene\.dgs\.part (was begun with|begins with another keyframe)"):
        encode(moving_rig, output=output, resume=True, keyframe=keyframe)
    assert encode(moving_rig, output=output, resume=True, keyframe=moving.path).data == moving.data


def test_another_rig_is_refused(encode: Any, moving: Any, moving_rig: Path, lens_rig: Path, tmp_path: Path) -> None:
    output = part(tmp_path, moving.data[: ends(moving.path)[1]])
    with pytest.raises(
        UsageError, match=r"was begun with other pictures: frame 0 of cam00 and \d more cameras differs"
    ):
        encode(lens_rig, output=output, resume=True)
    moved = Path(shutil.copytree(moving_rig, tmp_path / "rig"))
    document = json.loads((moved / "rig.json").read_text())
    document["cameras"][1]["fx"] += 1
    (moved / "rig.json").write_text(json.dumps(document))
    with pytest.raises(UsageError, match="was begun with cameras"):
        encode(moved, output=output, resume=True)


# Footage that is not the stream's


def swap(one: Path, other: Path) -> None:
    """Exchanges two files' contents; their time stamps stay."""
    for path, data in ((one, other.read_bytes()), (other, one.read_bytes())):
        stamp = path.stat()
        path.write_bytes(data)
        os.utime(path, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))


@pytest.mark.parametrize("frames", [1, 3])
def test_pictures_that_were_swapped_are_told(
    moving: Any, moving_rig: Path, tiny_settings: Any, tmp_path: Path, frames: int
) -> None:
    """Of two cameras alone, with the old time stamps: ``resume`` refuses, ``keyframe`` warns."""
    rig, output = Path(shutil.copytree(moving_rig, tmp_path / "rig")), tmp_path / "scene.dgs"
    for one, other in zip(sorted((rig / "cam01").iterdir()), sorted((rig / "cam03").iterdir()), strict=True):
        swap(one, other)
    given = {"settings": tiny_settings, "holdout": ["cam02"]}
    left = moving.data[: ends(moving.path)[frames] + 7]
    growing = part(tmp_path, left).with_name("scene.dgs.part")
    problem = "other pictures: frame 0 of cam01 and 1 more cameras differs"
    with pytest.raises(UsageError, match=rf"scene\.dgs\.part was begun with {problem}; give the same recordings"):
        encode_rig(rig, output, resume=True, **given)
    assert growing.read_bytes() == left
    told: list[str] = []
    encode_rig(rig, tmp_path / "k.dgs", frames=slice(1), keyframe=moving.path, on_warning=told.append, **given)
    assert told == [f"`keyframe` {moving.path}: it was made from {problem}; is it of other footage?"]


@pytest.mark.parametrize("cameras", [["cam01"], ["cam00", "cam01", "cam03", "cam04"]])
def test_a_later_frame_of_other_footage_is_told(
    moving: Any, moving_rig: Path, tiny_settings: Any, tiny_rig: Any, tmp_path: Path, cameras: list[str]
) -> None:
    """The first frame is the same, times are kept: the last frame that was encoded does not match its pictures."""
    rig, output = Path(shutil.copytree(moving_rig, tmp_path / "rig")), tmp_path / "scene.dgs"
    given = {"settings": tiny_settings, "holdout": ["cam02"], "resume": True}
    told: list[str] = []
    part(tmp_path, moving.data[: ends(moving.path)[3]])
    encode_rig(rig, output, on_warning=told.append, **given)
    assert (output.read_bytes(), told) == (moving.data, [])
    output.unlink()
    for name in cameras:
        for path in sorted((rig / name).iterdir())[2:]:
            stamp = path.stat()
            cv2.imwrite(str(path), np.roll(cv2.imread(str(path)), 9, 1))
            os.utime(path, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    part(tmp_path, moving.data[: ends(moving.path)[3]])
    encode_rig(rig, output, on_warning=told.append, **given)
    more = f" and {len(cameras) - 1} more cameras" if len(cameras) > 1 else ""
    assert told == [
        f"`resume`: {output}.part: the scene does not match frame 2 of camera {cameras[0]}{more}; "
        "was it encoded from other footage?"
    ]


@pytest.mark.parametrize(
    ("first", "later", "told"), [(0.05, 0.09, False), (0.05, 0.11, True), (0.02, 0.05, False), (0.02, 0.06, True)]
)
def test_other_footage_is_missed_by_more_than_the_first_frame_was(first: float, later: float, told: bool) -> None:
    """By 6 dB more, and to less than 25 dB: 0.056 of white. Renderings are off by ``first``, then by ``later``."""
    picture = np.random.default_rng(1).uniform(0.2, 0.8, (3, 48, 64)).astype(np.float32)
    view = SimpleNamespace(camera=SimpleNamespace(name="cam01"), valid=None)
    context: Any = SimpleNamespace(
        ingest=SimpleNamespace(views=[view]), threads=1, renderer=lambda _, off: lambda _: picture + np.float32(off)
    )
    warnings: list[str] = []
    reporter = FrameReporter(context, warnings.append)
    for index, off in enumerate((first, later)):
        encoded: Any = SimpleNamespace(
            scene=SimpleNamespace(splats=off),
            memory=SimpleNamespace(views=None),
            masks=[],
            pictures=RigFrame(index, [picture], []),
        )
        reporter.check_footage(encoded, "`resume`: scene.dgs", Stopwatch())
    assert warnings == told * [
        "`resume`: scene.dgs: the scene does not match frame 1 of camera cam01; was it encoded from other footage?"
    ]


def test_a_published_stream_of_other_footage_stays(
    moving: Any, moving_rig: Path, tiny_settings: Any, tiny_rig: Any, tmp_path: Path
) -> None:
    output = tmp_path / "scene.dgs"
    given = {"settings": tiny_settings, "holdout": ["cam02"]}
    encode_rig(moving_rig, output, frames=slice(2), **given)
    before = output.read_bytes()
    with pytest.raises(UsageError, match=r"scene\.dgs was begun with other pictures: frame 0 of cam03 differs"):
        encode_rig(tiny_rig.poisoned(moving_rig, tmp_path / "rig", "cam03"), output, resume=True, **given)
    assert output.read_bytes() == before
    assert not (tmp_path / "scene.dgs.part").exists()


def test_the_same_pictures_in_other_files_are_the_same_footage(
    moving: Any, moving_rig: Path, tiny_settings: Any, tmp_path: Path
) -> None:
    """Packed anew, under another folder's name, written after the stream: gone on with, the last told."""
    output = part(tmp_path, moving.data[: ends(moving.path)[2]])
    rig = Path(shutil.copytree(moving_rig, tmp_path / "other"))
    for path in rig.rglob("*.png"):
        cv2.imwrite(str(path), cv2.imread(str(path)), [cv2.IMWRITE_PNG_COMPRESSION, 1])
    told: list[str] = []
    encode_rig(rig, output, tiny_settings, holdout=["cam02"], resume=True, on_warning=told.append)
    assert output.read_bytes() == moving.data
    growing = tmp_path / "scene.dgs.part"
    assert told == [f"`resume`: a recording was written after {growing}; start over if its frames are others"]


@pytest.mark.parametrize(
    "told", [None, 5, ["x"], {"cam00": "x"}, {"pictures": 5}, {"pictures": ["x"]}, {"pictures": [1] * 4}]
)
def test_a_stream_that_does_not_tell_its_pictures(
    encode: Any, moving: Any, moving_rig: Path, tmp_path: Path, told: Any
) -> None:
    """One from before is gone on with; one that tells nonsense is refused in one line."""
    with moving.path.open("rb") as file:
        header = StreamHeader.from_bytes(next(iterate_packets(file)).payload)
    settings = {name: value for name, value in header.settings.items() if name != "recorded"}
    old = replace(header, settings=settings | ({} if told is None else {"recorded": told}))
    output = tmp_path / "scene.dgs"
    with moving.path.open("rb") as file, (tmp_path / "scene.dgs.part").open("wb") as growing:
        writer = StreamWriter(growing, old.to_bytes())
        for packet in list(iterate_packets(file))[1:3]:
            writer.write(packet.kind, packet.frame, packet.payload)
    if told is None:
        assert encode(moving_rig, output=output, resume=True, on_keyframe_step=never).report.resumed == 2
    else:
        with pytest.raises(UsageError, match="was begun with recorded"):
            encode(moving_rig, output=output, resume=True)


@pytest.mark.parametrize("error", [KeyboardInterrupt, DecogsError])
def test_what_goes_wrong_while_frames_are_replayed_touches_nothing(
    encode: Any, moving: Any, moving_rig: Path, tmp_path: Path, error: type[BaseException]
) -> None:
    def fail(report: Any) -> None:
        raise error

    data = moving.data[: ends(moving.path)[3] + 3]
    output = part(tmp_path, data)
    with pytest.raises(error):
        encode(moving_rig, output=output, resume=True, on_frame=fail)
    assert [path.name for path in tmp_path.iterdir()] == ["scene.dgs.part"]
    assert (tmp_path / "scene.dgs.part").read_bytes() == data


# Killed


CHILD = """
import importlib.util, os, sys

conftest = sys.argv.pop(1)
sys.path.append(os.path.join(os.path.dirname(conftest), ".."))
specification = importlib.util.spec_from_file_location("encoder_conftest", conftest)
module = importlib.util.module_from_spec(specification)
sys.modules["encoder_conftest"] = module
specification.loader.exec_module(module)

from decogs.encoder import PRESETS
from decogs.encoder.commands import encode_main

PRESETS["tiny"] = module.TINY
sys.exit(encode_main())
"""
MOMENTS = (0, 1, 2, 3, 3, 2, 1, 0, 1, 3)


@pytest.fixture(scope="module")
def long_rig(tiny_rig: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny_rig.write(tmp_path_factory.mktemp("rigs") / "long", frames=MOMENTS)


def start(rig: Path, output: Path) -> tuple[subprocess.Popen[str], Path]:
    """An encode in a process of its own, which has begun: its log says so."""
    log = output.with_suffix(".jsonl")
    log.unlink(missing_ok=True)
    options = ["--preset", "tiny", "--segment", "4", "--threads", "1", "--resume", "--log", str(log)]
    conftest = str(Path(__file__).with_name("conftest.py"))
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, conftest, str(rig), "-o", str(output), *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 120
    while not (log.exists() and log.read_text().endswith("\n")):
        assert child.poll() is None, child.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.005)
    return child, log


def check_killed(
    rig: Path, folder: Path, moments: Iterable[Callable[[subprocess.Popen[str], Path], None]]
) -> list[int]:
    """Kills an encode at each of the moments (they wait for it, given process and log); the frames each kill left."""
    output = folder / "scene.dgs"
    child, _ = start(rig, folder / "whole.dgs")
    child.communicate(timeout=120)
    expected, left = (folder / "whole.dgs").read_bytes(), []
    for wait in moments:
        child, log = start(rig, output)
        wait(child, log)
        child.kill()
        _, err = child.communicate(timeout=120)
        assert said(err) == []
        if child.returncode == 0:  # it was quicker: the next one begins anew
            assert output.read_bytes() == expected
            output.unlink()
            continue
        assert child.returncode == -signal.SIGKILL
        growing = output.with_name("scene.dgs.part")
        data = growing.read_bytes() if growing.exists() else b""
        assert expected.startswith(data)
        left.append(sum(packet.kind in FRAME_KINDS for packet in iterate_packets(io.BytesIO(data), strict=False)))
    child, _ = start(rig, output)
    _, err = child.communicate(timeout=120)
    assert (child.returncode, said(err)) == (0, [])
    assert output.read_bytes() == expected
    return left


def said(err: str) -> list[str]:
    """What was printed, without the progress of an encode that takes seconds where the machine is busy."""
    return [line for line in err.splitlines() if not line.startswith("frames: ")]


def after(frames: int) -> Callable[[subprocess.Popen[str], Path], None]:
    """Waits for so many frames of the log, those that were there already counted."""

    def wait(child: subprocess.Popen[str], log: Path) -> None:
        while child.poll() is None and log.read_text().count('"event": "frame"') < frames:
            time.sleep(0.002)

    return wait


def test_killed(long_rig: Path, tmp_path: Path) -> None:
    """After 3 of the 10 frames."""
    assert all(frames >= 3 for frames in check_killed(long_rig, tmp_path, [after(3)]))


@pytest.mark.slow
def test_killed_twice(long_rig: Path, tmp_path: Path) -> None:
    left = check_killed(long_rig, tmp_path, [after(3), after(6)])
    assert left == sorted(left)
    assert all(frames >= 3 for frames in left)


@pytest.mark.soak
def test_killed_at_random_moments(long_rig: Path, tmp_path: Path) -> None:
    moments = random.Random(time.time_ns())

    def wait(child: subprocess.Popen[str], log: Path) -> None:
        with suppress(subprocess.TimeoutExpired):
            child.wait(moments.uniform(0, 1.5))

    left = check_killed(long_rig, tmp_path, [wait] * 40)
    assert len(left) >= 10
    assert len(set(left)) > 3, "killed before and between frames"
