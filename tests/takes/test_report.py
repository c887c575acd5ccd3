"""The report of a take: errors against what was recorded, in one page that needs nothing else."""

from __future__ import annotations

import base64
import io
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from decogs.decoder.editing import Grade, Trim, edit
from decogs.decoder.reading.stream import open_stream
from decogs.decoder.rendering.views import render_view
from decogs.formats.cameras import camera_centre
from decogs.formats.errors import UsageError
from decogs.formats.rigs import open_rig, read_frames
from decogs.takes.commands import report_main
from decogs.takes.compared import compare, pairs_of
from encode_rig import encode_rig


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory, moving_rig: Path) -> Path:
    path = tmp_path_factory.mktemp("report") / "scene.dgs"
    encode_rig(moving_rig, path, "live", frames=slice(1, 4), holdout=["cam02"], threads=1)
    return path


def test_errors_are_those_of_the_decoded_pictures(stream: Path, moving_rig: Path) -> None:
    compared = compare(stream, open_rig(str(moving_rig)), 2, lambda done, of: None)
    assert compared.frames == (0, 2)
    assert compared.held_out == ("cam02",)
    with open_stream(stream) as opened:
        *_, last = opened.frames()
        ((_, pictures),) = read_frames(open_rig(str(moving_rig)), 3, 4)  # the stream begins with the rig's frame 1
        for row, (name, picture) in enumerate(zip(compared.cameras, pictures, strict=True)):
            shown = np.clip(render_view(opened.header, last.splats, name).image, 0, 1)
            expected = -10 * np.log10(((shown - picture / np.float32(255)) ** 2).mean())
            assert compared.psnr[row, 1] == pytest.approx(expected, abs=0.01)


def test_pictures_beside_each_other_are_of_the_same_frame(stream: Path, moving_rig: Path) -> None:
    pairs = pairs_of(stream, open_rig(str(moving_rig)), [("cam00", 2), ("cam01", 0)])
    assert set(pairs) == {("cam00", 2), ("cam01", 0)}
    compared = compare(stream, open_rig(str(moving_rig)), 3, lambda done, of: None)
    for (camera, frame), pair in pairs.items():
        assert pair.psnr == compared.psnr[compared.cameras.index(camera), frame]


def test_the_page_holds_all_that_it_shows(stream: Path, moving_rig: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "report.html"
    assert report_main([str(stream), "--rig", str(moving_rig), "-o", str(out), "--title", "Take <3>", "-q"]) == 0
    page = out.read_text()
    assert "<h1>Take &lt;3&gt;</h1>" in page
    assert "cam02*" in page
    assert not re.findall(r"(?:src|href)=['\"](?!data:)", page)
    pictures = re.findall(r"data:image/jpeg;base64,([^']+)", page)
    assert len(pictures) == 10
    assert Image.open(io.BytesIO(base64.b64decode(pictures[0]))).size == (64, 48)
    assert base64.b64decode(re.findall(r"data:video/mp4;base64,([^']+)", page)[0])[4:8] == b"ftyp"
    again = tmp_path / "again.html"
    assert report_main([str(stream), "--rig", str(moving_rig), "-o", str(again), "--title", "Take <3>", "-q"]) == 0
    assert again.read_bytes() == out.read_bytes()


def test_the_map_alone_is_the_fence_of_a_player(
    stream: Path, moving_rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As the page has it; cameras stand in it."""
    page, alone = tmp_path / "report.html", tmp_path / "fence.json"
    for out in page, alone:
        assert report_main([str(stream), "--rig", str(moving_rig), "-o", str(out), "-q"]) == 0, capsys.readouterr().err
    fence = json.loads(alone.read_text())
    assert fence == json.loads(re.findall("id='where-it-holds'>(.*?)</script>", page.read_text())[0])
    axes, low, high = (np.array(fence[name]) for name in ("axes", "low", "high"))
    within = np.array(fence["within"])
    with open_stream(stream) as opened:
        places = np.array([camera_centre(camera) for camera in opened.header.cameras]) @ axes.T
    columns, rows = np.floor((places - low) / (high - low) * within.shape[::-1]).astype(int).T
    assert within[rows, columns].mean() > 0.5


@pytest.mark.parametrize(
    ("more", "named"),
    [
        (["--against", "other.dgs"], "--against: for a page"),
        (["--title", "", "--log", "encode.log"], "--log, --title: for a page"),
    ],
)
def test_a_fence_refuses_what_only_a_page_says(
    stream: Path, moving_rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str], named: str
) -> None:
    out = tmp_path / "fence.JSON"
    assert report_main([str(stream), "--rig", str(moving_rig), "-o", str(out), *more, "-q"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert named in line
    assert not out.exists()


def test_two_streams_beside_each_other(
    stream: Path, moving_rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One that was made darker is worse everywhere; the page says by how much."""
    other, page = tmp_path / "darker.dgs", tmp_path / "report.html"
    edit(stream, other, [Grade(exposure=-0.5), Trim(slice(0, 2))])
    assert report_main([str(stream), "--rig", str(moving_rig), "-o", str(page), "--against", str(other), "-q"]) == 0
    text = page.read_text()
    _, _, text = text.partition("<h2>Against darker.dgs</h2>")
    rig = open_rig(str(moving_rig))
    mine, theirs = (compare(each, rig, 12, lambda done, of: None, upto=2).psnr for each in (stream, other))
    assert (mine > theirs + 1).all()
    row, column = divmod(int(np.argmax(mine - theirs)), 2)
    camera = rig.cameras[row].name
    assert (
        f"{camera}, frame {column}: recorded; {mine[row, column]:.2f} dB; darker.dgs {theirs[row, column]:.2f} dB"
        in text
    )
    assert f"<td>{mine.mean():.2f}</td>" in text
    assert f"<td>{theirs.mean(axis=1).min():.2f}</td>" in text
    assert len(re.findall("data:image/jpeg", text)) == 10
    late = tmp_path / "late.dgs"
    edit(stream, late, [Trim(slice(1, 3))])
    assert report_main([str(stream), "--rig", str(moving_rig), "-o", str(page), "--against", str(late), "-q"]) == 2
    assert "begin with the rig's frames 1 and 2" in capsys.readouterr().err


def test_another_rig_is_refused(stream: Path, moving_rig: Path) -> None:
    rig = open_rig(str(moving_rig))
    others = tuple(replace(camera, name=f"other {camera.name}") for camera in rig.cameras)
    with pytest.raises(UsageError, match="no camera of this rig"):
        compare(stream, replace(rig, cameras=others), 2, lambda done, of: None)
    with pytest.raises(UsageError, match="ends before"):
        compare(stream, replace(rig, frame_count=1), 2, lambda done, of: None)


def test_no_input_is_overwritten(stream: Path, moving_rig: Path) -> None:
    before = stream.read_bytes()
    assert report_main([str(stream), "--rig", str(moving_rig), "-o", str(stream), "-q"]) == 2
    assert stream.read_bytes() == before


def test_the_page_says_what_the_encode_took(
    stream: Path, moving_rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Over all runs of one that was resumed."""
    log, page = tmp_path / "encode.log", tmp_path / "report.html"
    frame = {"event": "frame", "replayed": False}
    lines = [
        {"event": "start"},
        {**frame, "elapsed": 40.0, "cpu_seconds": 60.0},
        {"event": "start"},
        {**frame, "replayed": True, "elapsed": 1.0, "cpu_seconds": 0.5},
        {**frame, "elapsed": 3.0, "cpu_seconds": 1.0},
        {**frame, "elapsed": 5.0, "cpu_seconds": 2.0},
        {"event": "end", "elapsed": 6.0},
    ]
    log.write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    words = [str(stream), "--rig", str(moving_rig), "-o", str(page), "--log", str(log), "-q"]
    assert report_main(words) == 0
    told = "Encoded in 46 s with 63 seconds of processor time: 60 for the first frame, 1.50 CPU-s each later one."
    assert told in page.read_text()
    capsys.readouterr()
    for text, problem in (
        ("[]", "is no log"),
        ('{"event": "start"}', "no frame that was trained"),
        (None, "No such file"),
    ):
        log.write_text(text) if text is not None else log.unlink()
        assert report_main(words) == 2
        assert problem in capsys.readouterr().err
