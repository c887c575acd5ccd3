"""decogs-make: what a take file says is made, once, and again where it would be another; nothing else is touched."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from decogs.encoder.commands import encode_main, encode_options, encode_parser
from decogs.formats.errors import DecogsError
from decogs.takes.commands import make_main
from decogs.takes.making import Making
from decogs.takes.records import FILE, Records
from decogs.takes.steps import STAGING
from decogs.takes.take_file import read_take

VIDEOS = Path(__file__).parents[1] / "demo" / "workbench"
TAKE = """\
rig = "rig"
title = "Take 3"

[encode]
preset = "live"
frames = ":2"
scale = 0.8
threads = 1

[edit]
operations = ["clean --opacity 0.02"]

[deliver.page]
fence = "take/fence.json"

[deliver.fence]

[deliver.report]

[deliver.poster]
view = "cam00"

[deliver.turn]
kind = "video"
view = "cam01"
file = "films/turn.mp4"

[deliver.frames]
kind = "exr"
view = "cam02"
scale = 0.5
"""
STEPS = ["encode", "edit", "page", "fence", "report", "poster", "turn", "frames"]


def new_folder(folder: Path, rig: Path) -> Path:
    """A folder with a take, whose rig is linked."""
    folder.mkdir()
    (folder / "rig").symlink_to(rig)
    (folder / "take.toml").write_text(TAKE)
    return folder / "take.toml"


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory, moving_rig: Path) -> Path:
    take = new_folder(tmp_path_factory.mktemp("takes") / "day", moving_rig)
    assert make_main([str(take)]) == 0
    return take


@pytest.fixture
def made(undisturbed: Path, tmp_path: Path) -> Path:
    """A copy of what was made, with its record."""
    return shutil.copytree(undisturbed.parent, tmp_path / "day", symlinks=True) / "take.toml"


@pytest.fixture
def making(capfd: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, dict[str, str]]]:
    """Runs the command; its exit code, and the state of each step."""

    def run(*words: object) -> tuple[int, dict[str, str]]:
        capfd.readouterr()
        code = make_main(list(map(str, words)))
        rows = [line.split("  ") for line in capfd.readouterr().out.splitlines() if ".toml" in line and "  " in line]
        cells = [[cell.strip() for cell in row if cell.strip()] for row in rows]
        return code, {row[1]: row[2] for row in cells if len(row) > 2}

    return run


def files(take: Path) -> dict[str, bytes]:
    folder = take.parent / "take"
    found = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}
    return {name: path.read_bytes() for name, path in found.items() if not name.startswith(".decogs-make.")}


def test_all_is_made_and_nothing_twice(undisturbed: Path, made: Path, making) -> None:
    there = files(undisturbed)
    assert {"encoded.dgs", "scene.dgs", "page/index.html", "poster.png", "films/turn.mp4"} <= set(there)
    assert "frames/frame_0001.exr" in there
    assert there["page/fence.json"] == there["fence.json"]
    assert b' fence="./fence.json"' in there["page/index.html"]
    assert not list(undisturbed.parent.rglob(f"{STAGING}*"))
    assert making(made) == (0, dict.fromkeys(STEPS, "up to date"))
    assert files(made) == there


@pytest.mark.parametrize(
    ("old", "new", "again"),
    [
        ("--opacity 0.02", "--opacity 0.9", ["edit", "page", "fence", "report", "poster", "turn", "frames"]),
        ('view = "cam00"', 'view = "cam03"', ["poster"]),
        ("Take 3", "Take 4", ["edit", "page", "fence", "report", "poster", "turn", "frames"]),
        ("scale = 0.5", "scale = 0.25", ["frames"]),
    ],
)
def test_what_changes_is_made_again_with_what_depends_on_it(
    made: Path, making, old: str, new: str, again: list
) -> None:
    made.write_text(TAKE.replace(old, new))
    code, states = making(made, "--dry-run")
    assert (code, [name for name in STEPS if states[name] == "due"]) == (0, again)
    code, states = making(made, "-j", 2)
    done = [name for name in STEPS if states[name] == "made"]
    assert code == 0
    assert done == again
    assert making(made)[1] == dict.fromkeys(STEPS, "up to date")


def test_steps_that_read_each_other_are_refused(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made.write_text(
        TAKE + '[deliver.b]\nkind = "page"\nfence = "take/c"\n[deliver.c]\nkind = "page"\nfence = "take/b"\n'
    )
    for words in [], ["--dry-run"]:
        assert make_main([str(made), *words]) == 2
        assert "b and c read what the other makes" in capsys.readouterr().err


def test_what_comes_out_with_the_same_bytes_makes_nothing_else_anew(made: Path, making) -> None:
    made.write_text(TAKE.replace("threads = 1", "threads = 2"))
    code, states = making(made)
    assert (code, [name for name in STEPS if states[name] == "made"]) == (0, ["encode"])


def test_other_footage_is_encoded_anew(made: Path, making, moving_rig: Path) -> None:
    (made.parent / "rig").unlink()
    shutil.copytree(moving_rig, made.parent / "rig")
    assert making(made, "--dry-run")[1]["encode"] == "up to date"  # the same in another place
    shutil.copytree(moving_rig / "cam01", made.parent / "rig" / "cam00", dirs_exist_ok=True)
    assert set(making(made, "--dry-run")[1].values()) == {"due"}


def test_what_is_lost_is_made_again(made: Path, making) -> None:
    (made.parent / "take" / "poster.png").unlink()
    shutil.rmtree(made.parent / "take" / "page")
    code, states = making(made)
    assert (code, [name for name in STEPS if states[name] == "made"]) == (0, ["page", "poster"])


@pytest.mark.parametrize(
    "name",
    ["poster.png", *(pytest.param(f"page/{name}", marks=pytest.mark.slow) for name in ("index.html", "notes.txt"))],
)
def test_what_it_did_not_make_stays(made: Path, making, name: str) -> None:
    """A changed file, and one of somebody else in a folder that would be replaced."""
    theirs = made.parent / "take" / name
    theirs.write_bytes(b"somebody's own")
    made.write_text(TAKE.replace("Take 3", "Take 4"))
    code, states = making(made)
    assert code == 2
    step = name.partition("/")[0].removesuffix(".png")
    assert [name for name in STEPS if states[name] == "failed"] == [step]
    assert theirs.read_bytes() == b"somebody's own"
    theirs.unlink()
    assert making(made)[0] == 0


def test_without_a_record_nothing_counts_as_made(made: Path, making) -> None:
    (made.parent / "take" / FILE).unlink()
    before = files(made)
    code, states = making(made)
    assert code == 2
    assert {states[name] for name in STEPS} == {"failed", "left out"}
    assert files(made) == before
    for text in ("{}", "[]", "x", '{"version": 1, "made": {"encode": {"bad": 1}}, "begun": {}, "digests": {}}'):
        (made.parent / "take" / FILE).write_text(text)
        assert making(made) == (2, {})


def test_two_do_not_make_one_take(made: Path, making) -> None:
    with Records(made.parent / "take").locked():
        assert making(made) == (2, {})
        assert making(made, "--dry-run")[0] == 0
    assert making(made)[0] == 0


def test_what_fails_leaves_the_others(made: Path, making) -> None:
    made.write_text(TAKE.replace('view = "cam01"', 'view = "nobody"').replace("scale = 0.5", "scale = 0.25"))
    code, states = making(made)
    assert code == 2
    assert states["turn"] == "failed"
    assert states["frames"] == "made"
    made.write_text(TAKE.replace('frames = ":2"', 'frames = "1:3"').replace("0.8\n", "0.81\n"))
    (made.parent / "take" / "encoded.dgs").write_bytes(b"")
    code, states = making(made)
    assert states["encode"] == "failed"
    assert {states[name] for name in STEPS[1:]} == {"left out"}


@pytest.mark.slow
def test_killed_at_any_place_it_makes_the_same(undisturbed: Path, tmp_path: Path, moving_rig: Path) -> None:
    """SIGKILL in each step, one after the other; the command that ran ends, too."""
    take = new_folder(tmp_path / "day", moving_rig)
    program = "import sys; from decogs.takes.commands import make_main; sys.exit(make_main(sys.argv[1:]))"
    command = [sys.executable, "-c", program, str(take)]
    for step in ["encode", "edit", "fence", "page", "report", "poster"]:  # as they are made: the page has the fence
        with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as process:
            assert process.stderr is not None
            while not (line := process.stderr.readline()).startswith(f"{step}:"):
                assert line, "it ended by itself"
            time.sleep(2.5 if step == "encode" else 0)
            os.kill(process.pid, signal.SIGKILL)
            process.stderr.read()  # up to the end of the command that ran
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert files(take) == files(undisturbed)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "names no rig"),
        ("rig = 3", "rig is no text"),
        ('rig = "rig"\nencode = 1', "encode is no table"),
        ('rig = "rig"\nfps = 1', "there is no 'fps' in a take; it has rig, output"),
        ('rig = "rig"\noutput = "/tmp/x"', "write a path below"),
        ('rig = "rig"\noutput = "../x"', "write a path below"),
        ('rig = "rig"\n[encode]\npresett = "live"', "'presett' is no option of decogs-encode here; it has ablate,"),
        ('rig = "rig"\n[encode]\noutput = "x"', "'output' is no option"),
        ('rig = "rig"\n[encode]\nlayers = "yes"', "layers is a switch: write true or false"),
        ('rig = "rig"\n[encode]\npreset = ["live"]', "preset is given once"),
        ('rig = "rig"\n[encode]\nscale = "big"', "[encode]: argument --scale"),
        ('rig = "rig"\n[encode]\nscale = true', "write a text or a number"),
        ('rig = "rig"\n[edit]\noperations = ["cleen"]', "[edit]: cleen: there is no such operation"),
        ('rig = "rig"\n[edit]\noperations = "clean"', "holds a list alone"),
        ('rig = "rig"\n[edit]\noperations = ["set --title \'x"]', "No closing quotation"),
        ('rig = "rig"\n[deliver.film]', "kind 'film' is none of page, poster"),
        ('rig = "rig"\n[deliver.encode]\nkind = "page"', "is a step of the take itself"),
        ('rig = "rig"\n[deliver."a b"]\nkind = "page"', "'a b' is no name"),
        ('rig = "rig"\n[deliver]\npage = 1', "is no table"),
        ('rig = "rig"\n[deliver.poster]', "says from where: view, camera, orbit or spiral"),
        (
            'rig = "rig"\n[deliver.page]\nfile = "scene.dgs"',
            "makes take/scene.dgs, where [encode] makes take/scene.dgs",
        ),
        ('rig = "rig"\n[deliver.page]\n[deliver.usd]\nfile = "page/x.usdc"', "where [page] makes take/page"),
        ('rig = "rig"\n[deliver.splats]\nfile = "x_####.ply"', "is many files: put them into a folder"),
        ('rig = "rig"\n[deliver.video]\nfile = "../x.mp4"\norbit = true', "write a path below"),
        ("rig = ", "malformed TOML"),
    ],
)
def test_what_is_wrong_in_a_take_is_said(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "take.toml").write_text(text)
    with pytest.raises(DecogsError) as caught:
        read_take(tmp_path / "take.toml")
    assert said in str(caught.value)
    assert str(tmp_path / "take.toml") in str(caught.value)


def test_a_list_repeats_an_option_and_a_switch_may_be_off(tmp_path: Path) -> None:
    text = 'rig = "rig"\n[encode]\nholdout = ["cam00", "cam05"]\nlayers = false\nclosed = true\nframes = "-3:"'
    (tmp_path / "take.toml").write_text(text)
    (step,) = read_take(tmp_path / "take.toml").steps
    assert step.words == ("--holdout=cam00", "--holdout=cam05", "--closed", "--frames=-3:")
    assert step.line()[:4] == ["decogs-encode", "rig", "-o", "take/scene.dgs"]


def test_cameras_are_placed_and_put_in_step_before(tmp_path: Path) -> None:
    text = 'rig = "videos"\n[calibrate]\nsync = "auto"\n[sync]\n[encode]'
    (tmp_path / "take.toml").write_text(text)
    lines = [step.text for step in read_take(tmp_path / "take.toml").steps]
    assert lines == [
        "decogs-calibrate videos -o take/rig --sync=auto",
        "decogs-sync take/rig -o take/rig_in_step",
        "decogs-encode take/rig_in_step -o take/scene.dgs",
    ]


def test_steps_are_told_of_threads_where_the_take_does_not_say(tmp_path: Path, moving_rig: Path) -> None:
    take = read_take(new_folder(tmp_path / "day", moving_rig))
    told = {step.name: Making(take, print, threads=2)._told_threads(step) for step in take.steps}
    of_two = ["--threads=2"]
    assert told == {**dict.fromkeys(STEPS, of_two), "encode": [], "page": []}
    assert not any(Making(take, print)._told_threads(step) for step in take.steps)


def test_takes_do_not_share_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a", "b"):
        (tmp_path / f"{name}.toml").write_text('rig = "rig"\noutput = "same"')
    assert make_main([str(tmp_path / "a.toml"), str(tmp_path / "b.toml")]) == 2
    assert "its output is that of" in capsys.readouterr().err


def test_a_first_file_is_written_from_the_analysis(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    take = tmp_path / "take.toml"
    assert make_main([str(take), "--new", str(VIDEOS), "-q"]) == 0
    text = take.read_text()
    assert "# cam00" in text
    assert [step.name for step in read_take(take).steps] == ["encode", "page", "poster", "video", "usd"]
    assert make_main([str(take), "--new", str(VIDEOS), "-q"]) == 2
    assert "is there already" in capsys.readouterr().err
    assert take.read_text() == text


def test_a_first_file_of_bare_videos_places_the_cameras(tmp_path: Path) -> None:
    videos = tmp_path / "videos"
    videos.mkdir()
    for camera in ("cam00", "cam01"):
        (videos / f"{camera}.mp4").symlink_to(VIDEOS / f"{camera}.mp4")
    assert make_main([str(tmp_path / "take.toml"), "--new", str(videos), "-q"]) == 0
    assert [step.name for step in read_take(tmp_path / "take.toml").steps][:2] == ["calibrate", "encode"]
    shutil.rmtree(videos)
    videos.mkdir()
    assert make_main([str(tmp_path / "other.toml"), "--new", str(videos), "-q"]) == 2


def test_an_encode_reads_its_part(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is given beside it counts; a list goes on."""
    take = tmp_path / "take.toml"
    take.write_text('rig = "rig"\n[encode]\npreset = "high"\nholdout = ["cam00"]\nscale = 0.5\n[deliver.page]')
    parser = encode_parser()
    given = ["--config", str(take), "-o", "x.dgs", "--scale", "0.25", "--holdout", "cam01"]
    options = encode_options(parser, given)
    assert (options.settings, options.scale, options.holdout) == ("high", 0.25, ["cam00", "cam01"])
    assert options.rig_dir == str(tmp_path / "rig")
    assert encode_options(parser, [*given, "another"]).rig_dir == "another"
    take.write_text('rig = "rig"\n[encode]\noutput = "y.dgs"')
    assert encode_main(["--config", str(take), "-o", "x.dgs"]) == 2
    assert "'output' is no option of decogs-encode here" in capsys.readouterr().err
    take.write_text("encode = 1")
    assert encode_main(["--config", str(take), "-o", "x.dgs"]) == 2
