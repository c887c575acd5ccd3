"""decogs-pack: files of Gaussians, one a frame, become a stream that shows what they hold."""

from __future__ import annotations

import resource
import signal
import subprocess
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decogs.bench.rivals.fourdgs import FourDGS
from decogs.bench.rivals.sequences import SceneFrame
from decogs.decoder import export
from decogs.decoder.reading.frame import DecodedFrame
from decogs.decoder.reading.stream import open_stream
from decogs.decoder.rendering.views import render_view
from decogs.encoder import pack
from decogs.encoder.input.row_matching import mutual_nearest
from decogs.encoder.packing import inputs
from decogs.encoder.packing.commands import pack_main
from decogs.formats.errors import UsageError
from decogs.formats.rigs import open_rig
from decogs.formats.splat_files.ply import Ply
from decogs.formats.splat_sequences import SequenceFrame, fourdgs, splat4d
from decogs.formats.splats import Splats, join_splats, take_splats

RIG = Path(__file__).resolve().parents[1] / "demo" / "workbench"


def a_scene(count: int = 400) -> Splats:
    """Round Gaussians about a unit cube, no two near each other."""
    random = np.random.default_rng(3)
    values = (
        random.uniform(-1, 1, (count, 3)),
        random.uniform(-3, -2.5, (count, 3)),
        random.normal(size=(count, 4)),
        random.uniform(-1, 3, count),
        random.uniform(-1, 1, (count, 4, 3)),
    )
    return Splats(*(np.ascontiguousarray(value, np.float32) for value in values))


def moved(splats: Splats, frame: int) -> Splats:
    """The first twenty rows go 0.004 to the right a frame."""
    means = splats.means.copy()
    means[:20, 0] += 0.004 * frame
    return replace(splats, means=means)


def write(folder: Path, frames: list[Splats], first: int = 0) -> str:
    for number, splats in enumerate(frames, first):
        (folder / f"a_{number:04d}.ply").write_bytes(Ply(compensated=True).encode(splats))
    return str(folder / "a_####.ply")


def decoded(path: Path) -> tuple[Any, list[DecodedFrame]]:
    with open_stream(path, strict=True) as stream:
        return stream.header, list(stream.frames())


def nearest_rows(found: Splats, splats: Splats) -> np.ndarray:
    distances = np.linalg.norm(found.means[:, None] - splats.means[None], axis=2)
    assert distances.min(axis=1).max() < 1e-2
    return np.asarray(distances.argmin(axis=1))


@pytest.mark.parametrize("lossless", [False, True])
def test_rows_in_one_order_are_a_keyframe_and_small_deltas(tmp_path: Path, lossless: bool) -> None:
    scene = a_scene()
    frames = [moved(scene, frame) for frame in range(4)]
    report = pack(write(tmp_path, frames, 17), tmp_path / "o.dgs", fps=24, lossless=lossless)
    header, found = decoded(tmp_path / "o.dgs")
    assert (len(found), header.fps, header.first_frame, header.sh_degree) == (4, 24, 17, 1)
    assert report.total_bytes == (tmp_path / "o.dgs").stat().st_size
    assert report.read_bytes == sum(path.stat().st_size for path in tmp_path.glob("*.ply"))
    assert report.matched_by_position == 0
    assert max(report.frame_bytes[1:]) < report.frame_bytes[0] / 10
    for frame, splats in zip(found, frames, strict=True):
        changes = frame.state.next_id
        assert changes == 400
        back = take_splats(splats, nearest_rows(frame.splats, splats))
        steps = header.lattice
        # Half a step when rounded; three quarters where a value's integer is held.
        share = 0.5 if lossless else 0.75
        for name, step in (("log_scales", steps.log_scales), ("opacity_logits", steps.opacity_logits)):
            assert np.abs(getattr(frame.splats, name) - getattr(back, name)).max() <= share * step * 1.001
        assert np.abs(frame.splats.sh[:, 0] - back.sh[:, 0]).max() <= share * steps.sh_dc * 1.001
        assert np.abs(frame.splats.means - back.means).max() <= share * steps.means[0] * 1.01


def test_what_comes_goes_and_is_shuffled_is_matched_by_position(tmp_path: Path) -> None:
    scene, random = a_scene(), np.random.default_rng(5)
    newcomer = replace(take_splats(scene, np.arange(3)), means=np.float32([[3, 0, 0], [0, 3, 0], [0, 0, 3]]))
    order = random.permutation(400)
    frames = [
        scene,
        take_splats(moved(scene, 1), np.arange(10, 400)),
        take_splats(join_splats(scene, newcomer), np.arange(10, 403)),
        take_splats(join_splats(scene, newcomer), np.arange(10, 403)[random.permutation(393)]),
        take_splats(scene, order),
    ]
    report = pack(write(tmp_path, frames), tmp_path / "o.dgs")
    _, found = decoded(tmp_path / "o.dgs")
    assert report.matched_by_position == 4
    assert [len(frame.splats) for frame in found] == [400, 390, 393, 393, 400]
    # Ten go; three come; none; three go and ten come. Ids are not given twice.
    assert [frame.state.next_id for frame in found] == [400, 400, 403, 403, 413]
    for frame, splats in zip(found, frames, strict=True):
        assert sorted(nearest_rows(frame.splats, splats)) == list(range(len(splats)))


def test_noise_below_the_lattice_is_not_coded(tmp_path: Path) -> None:
    scene, random = a_scene(), np.random.default_rng(6)
    pack(write(tmp_path, [scene]), tmp_path / "o.dgs")
    lattice = decoded(tmp_path / "o.dgs")[0].lattice
    noisy = [
        replace(scene, log_scales=scene.log_scales + np.float32(0.2 * lattice.log_scales) * sign)
        for sign in random.choice(np.float32([-1, 1]), (3, 400, 3))
    ]
    held = pack(write(tmp_path, [scene, *noisy]), tmp_path / "held.dgs").frame_bytes
    assert max(held[1:]) < 100
    assert min(pack(write(tmp_path, [scene, *noisy]), tmp_path / "all.dgs", lossless=True).frame_bytes[1:]) > 200


def test_quality_buys_bytes(tmp_path: Path) -> None:
    name = write(tmp_path, [moved(a_scene(), frame) for frame in range(2)])
    sizes = [pack(name, tmp_path / "o.dgs", quality=quality).total_bytes for quality in (0, 25, 50, 75, 100)]
    assert sizes == sorted(set(sizes))


@pytest.mark.parametrize("suffix", [".ply", ".spz"])
def test_an_export_is_packed_and_its_overview_stands_upright(moving: Any, tmp_path: Path, suffix: str) -> None:
    """What is above the middle in the rig's picture is above it in the overview; counts differ between the frames."""
    export(moving.path, tmp_path / f"x_####{suffix}", first_frame=5)
    warnings: list[str] = []
    pack(tmp_path / f"x_####{suffix}", tmp_path / "o.dgs", quality=75, on_warning=warnings.append)
    header, found = decoded(tmp_path / "o.dgs")
    _, frames = decoded(moving.path)
    assert warnings == []
    assert [len(frame.splats) for frame in found] == [len(frame.splats) for frame in frames]
    picture = render_view(header, found[0].splats, "overview").image
    assert picture.std() > 0.02
    assert not np.isnan(picture).any()
    rows = np.einsum("k,nk->n", header.cameras[0].world_to_camera[1, :3], found[0].splats.means)
    theirs = frames[0].splats.means[:, 1]
    assert abs(np.sort(rows - rows.mean()) - np.sort(theirs - theirs.mean())).max() < 0.02


@dataclass(frozen=True)
class ASequence:
    """Stands for a file of a peer's; ``rows``: of the scene, in each frame."""

    rows: tuple[tuple[int, ...], ...]
    fps: float = 12.5
    up: str = "-Y"

    @property
    def frame_count(self) -> int:
        return len(self.rows)

    def frames(self) -> Iterator[SequenceFrame]:
        for number, rows in enumerate(self.rows):
            ids = np.array(rows, np.int64)
            yield SequenceFrame(take_splats(moved(a_scene(), 500 * number), ids), 7 * ids, ("2 left out",))


def a_peers_file(folder: Path, monkeypatch: pytest.MonkeyPatch, *rows: Iterable[int]) -> Path:
    path = folder / "a.4dgs"
    path.write_bytes(b"a peer's")
    monkeypatch.setattr(inputs, "open_sequence", lambda *asked: ASequence(tuple(map(tuple, rows))))
    return path


def test_gaussians_of_one_id_are_the_same_wherever_they_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Twenty jump by the whole scene; some come and go, all go, and their order is not kept."""
    order = [range(0, 390), range(399, 9, -1), [], range(5, 400)]
    warnings: list[str] = []
    path = a_peers_file(tmp_path, monkeypatch, *order)
    report = pack(path, tmp_path / "o.dgs", on_warning=warnings.append)
    header, found = decoded(tmp_path / "o.dgs")
    assert (header.fps, header.first_frame, [camera.name for camera in header.cameras]) == (12.5, 0, ["overview"])
    assert (report.read_bytes, report.matched_by_position) == (len(b"a peer's"), 0)
    assert [len(frame.splats) for frame in found] == [390, 390, 0, 395]
    # Ten go and ten come; all go; those that come back are new.
    assert [frame.state.next_id for frame in found] == [390, 400, 400, 795]
    for number, (frame, rows) in enumerate(zip(found, order, strict=True)):
        if rows:
            theirs = take_splats(moved(a_scene(), 500 * number), np.array(rows))
            assert sorted(nearest_rows(frame.splats, theirs)) == list(range(len(theirs)))
    assert [text for text in warnings if "antialiasing" in text] == [warnings[1]]
    assert warnings[0] == f"{path}, frame 0: 2 left out"


def test_a_stream_cannot_begin_with_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = a_peers_file(tmp_path, monkeypatch, [], [1, 2])
    with pytest.raises(UsageError, match=r"a\.4dgs, frame 0: has no Gaussian, and a stream begins with some"):
        pack(path, tmp_path / "o.dgs")
    assert list(tmp_path.iterdir()) == [path]


def test_a_rig_s_cameras_see_what_was_packed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files, output = write(tmp_path, [a_scene()] * 2), tmp_path / "o.dgs"
    rig = open_rig(RIG)
    assert pack_main([files, "-o", str(output), "--rig", str(RIG), "--holdout", "cam00", "-q"]) == 0
    header, _ = decoded(output)
    assert [(each.name, each.width) for each in header.cameras] == [(each.name, each.width) for each in rig.cameras]
    assert (header.held_out, header.fps, header.units) == (("cam00",), rig.fps, rig.length_unit or header.units)
    capsys.readouterr()
    for options, says in (
        (["--rig", str(RIG), "--holdout", "cam99"], "error: --holdout cam99: "),
        (["--holdout", "cam00"], "error: --holdout: goes with --rig, whose cameras it names"),
    ):
        assert pack_main([files, "-o", str(tmp_path / "p.dgs"), *options]) == 2
        assert says in capsys.readouterr().err
    assert not (tmp_path / "p.dgs").exists()


@pytest.mark.parametrize(("suffix", "package"), [(".4dgs", "fourdgs"), (".splat4d", "splats4d")])
def test_a_peer_s_file_without_its_package_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], suffix: str, package: str
) -> None:
    monkeypatch.setattr(fourdgs.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(splat4d, "splat4d_command", lambda: None)
    path = tmp_path / f"a{suffix.upper()}"
    path.write_bytes(b"anything")
    assert pack_main([str(path), "-o", str(tmp_path / "o.dgs")]) == 2
    assert capsys.readouterr().err.endswith(f"which is not installed: pip install {package}\n")
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.skipif(not fourdgs.has_fourdgs(), reason="needs the PyPI package fourdgs")
def test_a_damaged_4dgs_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = a_scene()
    frames = [SceneFrame(np.arange(400), moved(scene, number)) for number in range(4)]
    FourDGS("fine").write(lambda: iter(frames), tmp_path)
    path = tmp_path / "scene.4dgs"
    assert pack_main([str(path), "-o", str(tmp_path / "whole.dgs"), "-q"]) == 0
    header, found = decoded(tmp_path / "whole.dgs")
    assert (len(found), header.fps) == (4, 30)
    data = bytearray(path.read_bytes())
    second = chunks_of(bytes(data))[1]
    data[second + 40 : second + 60] = bytes(20)
    path.write_bytes(data)
    capsys.readouterr()
    assert pack_main([str(path), "-o", str(tmp_path / "o.dgs"), "-q"]) == 2
    said = capsys.readouterr().err.splitlines()
    assert said[-1].startswith(f"decogs-pack: error: {path}: ")
    assert not list(tmp_path.glob("o.dgs*"))


def chunks_of(data: bytes) -> list[int]:
    """Where the chunks of a .4dgs begin."""
    from fourdgs import keyframe_delta_file

    return [entry.chunk_offset for entry in keyframe_delta_file.open_indexed(data).index]


def test_what_cannot_be_packed_is_one_line(tmp_path: Path) -> None:
    scene = a_scene(20)
    name = write(tmp_path, [scene, scene])
    flat = replace(scene, sh=scene.sh[:, :1])
    for frames, arguments, says in (
        ([scene, flat], {}, "a_0001.ply: has SH degree 0"),
        ([scene], {"quality": 101}, "`quality` 101"),
        ([scene], {"fps": float("nan")}, "`fps` nan"),
        ([scene], {"segment": -1}, "`segment` -1"),
        ([replace(scene, means=scene.means * 0)], {}, "in one place"),
        ([replace(scene, means=scene.means * np.float32(1e30))], {}, "cannot hold a scene of 2e[+]30|units; scale"),
        ([scene, replace(scene, means=scene.means * np.float32(1e30))], {}, "a_0001.ply: means do not fit 32 bits"),
    ):
        write(tmp_path, frames)
        output = tmp_path / "o.dgs"
        with pytest.raises(UsageError, match=says) as caught:
            pack(name, output, **arguments)
        assert "\n" not in str(caught.value)
        assert not list(tmp_path.glob("o.dgs*"))
    for given, says in (
        (tmp_path / "a_0000.ply", "no place for the frame's number"),
        (tmp_path / "b_####.ply", "there is no such file"),
        (tmp_path / "none" / "b_####.ply", "No such file"),
    ):
        with pytest.raises(UsageError, match=says):
            pack(given, tmp_path / "o.dgs")
    (tmp_path / "a_0003.ply").write_bytes(b"")
    with pytest.raises(UsageError, match=r"after a_0001.ply comes number 3"):
        pack(name, tmp_path / "o.dgs")
    (tmp_path / "a_0003.ply").unlink()
    with pytest.raises(UsageError, match="is read"):
        pack(tmp_path / "a_000#.ply", tmp_path / "a_0000.ply")


def test_more_than_the_memory_holds_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    files = write(tmp_path, [a_scene()])
    with pytest.raises(UsageError, match=r"_0000\.ply: holds 400 Gaussians.*`max_memory`"):
        pack(files, tmp_path / "packed.dgs", max_memory=400 * 1000)
    assert [path.suffix for path in tmp_path.iterdir()] == [".ply"]


def test_a_bad_file_in_the_middle_leaves_nothing(tmp_path: Path) -> None:
    name = write(tmp_path, [a_scene(20)] * 3)
    (tmp_path / "a_0001.ply").write_bytes(b"ply\n")
    assert pack_main([name, "-o", str(tmp_path / "o.dgs")]) == 2
    assert not list(tmp_path.glob("o.dgs*"))


def test_mutual_nearest_is_what_trying_all_pairs_finds() -> None:
    random = np.random.default_rng(8)
    first, second = (random.uniform(-1, 1, (count, 3)).astype(np.float32) for count in (300, 250))
    for reach in (0.01, 0.1, 0.5):
        distances = np.linalg.norm(first[:, None].astype(float) - second[None], axis=2)
        there, back = distances.argmin(axis=1), distances.argmin(axis=0)
        wanted = [i for i in range(300) if back[there[i]] == i and distances[i, there[i]] < reach]
        rows, others = mutual_nearest(first, second, reach)
        assert rows.tolist() == wanted
        assert others.tolist() == there[wanted].tolist()
    assert len(mutual_nearest(first[:0], second, 1.0)[0]) == 0


def test_what_a_killed_command_left_is_told_without_resume(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """There is no such option; an encode may still need what is there."""
    files = write(tmp_path, [a_scene()])
    (tmp_path / "x.dgs.part").write_bytes(b"the beginning of an encode")
    assert pack_main([files, "-o", str(tmp_path / "x.dgs")]) == 2
    said = capsys.readouterr().err
    assert "x.dgs.part: a command that was cut off left it; delete it" in said
    assert "resume" not in said
    assert (tmp_path / "x.dgs.part").read_bytes() == b"the beginning of an encode"


@pytest.mark.parametrize("ended_by", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_signal_leaves_nothing_of_a_stream(tmp_path: Path, ended_by: signal.Signals) -> None:
    """The command waits in the midst of its second frame."""
    program = """
import signal, sys, time
from decogs.encoder.packing import commands
from decogs.encoder.packing import packing
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # ignored by what runs under nohup
signal.signal(signal.SIGINT, signal.default_int_handler)
def wait(*arguments):
    print("waiting", flush=True)
    time.sleep(60)
packing._Packing._next = wait
sys.exit(commands.pack_main())
"""
    files = write(tmp_path, [a_scene(), a_scene()])
    arguments = [sys.executable, "-c", program, files, "-o", str(tmp_path / "x.dgs")]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"waiting\n"
        assert (tmp_path / "x.dgs.part").exists()
        process.send_signal(ended_by)
        process.communicate(timeout=60)
    assert process.returncode == (130 if ended_by == signal.SIGINT else -ended_by)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a_0000.ply", "a_0001.ply"]


def test_a_full_disk_is_told_without_resume(tmp_path: Path) -> None:
    """A limit on the size of files stands for the disk's."""
    program = "import sys; from decogs.encoder.packing import commands; sys.exit(commands.pack_main())"
    files = write(tmp_path, [a_scene()])

    def short() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))

    arguments = [sys.executable, "-c", program, files, "-o", str(tmp_path / "x.dgs")]
    ended = subprocess.run(arguments, capture_output=True, preexec_fn=short, check=False)
    assert ended.returncode == 2
    assert b"x.dgs.part: File too large; free space, or name a file elsewhere" in ended.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["a_0000.ply"]


def test_what_a_killed_one_has_left_is_made_anew_and_an_encode_s_is_not(moving: Any, tmp_path: Path) -> None:
    """A farm's second try works; of an encode, there is more to lose."""
    files, growing = write(tmp_path, [a_scene()] * 3), tmp_path / "o.dgs.part"
    pack(files, tmp_path / "o.dgs")
    data = (tmp_path / "o.dgs").read_bytes()
    for size in (20, len(data) // 2, len(data) - 30):
        growing.write_bytes(data[:size])
        pack(files, tmp_path / "o.dgs")
        assert (tmp_path / "o.dgs").read_bytes() == data
        assert not growing.exists()
    growing.write_bytes(moving.data[:-100])
    with pytest.raises(UsageError, match=r"o\.dgs\.part: a command that was cut off left it; delete it, unless"):
        pack(files, tmp_path / "o.dgs")
    assert growing.read_bytes() == moving.data[:-100]
