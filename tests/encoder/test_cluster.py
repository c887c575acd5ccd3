"""``--cluster``: the bytes of an encode on one machine, whatever happens to workers and machines on the way.

With a real Ray cluster of several nodes on this machine; skipped where Ray is not installed (`pip install
'ray[client]'`).
"""

from __future__ import annotations

import os
import shutil
import signal
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest

from decogs.decoder.exporting.exporting import export
from decogs.encoder import EncodeJob
from decogs.encoder.cluster import ray_engine
from decogs.encoder.cluster.encoding import encode_on_cluster
from decogs.encoder.cluster.ray_engine import RayEngine
from decogs.encoder.cluster.tasks import Outcome, run_part
from decogs.encoder.commands import encode_main
from decogs.encoder.settings.frame import SignificanceSettings
from decogs.formats.errors import TryAgainError, UsageError
from encode_rig import encode_rig as encode

MOMENTS = (0, 1, 3, 1, 3, 0, 3, 1)
SEGMENT = 2

pytestmark = pytest.mark.filterwarnings("default")
"""Ray's own."""


@pytest.fixture(scope="module")
def rig(tiny_rig: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny_rig.write(tmp_path_factory.mktemp("rigs") / "take", frames=MOMENTS)


@pytest.fixture(scope="module")
def settings(tiny_settings: Any) -> Any:
    """Long enough for a part to be killed in the middle."""
    significance = SignificanceSettings(threshold=1.0)
    frame = replace(tiny_settings.frame, joint_iterations=400, significance=significance)
    return replace(tiny_settings, frame=frame)


@pytest.fixture(scope="module")
def whole(rig: Path, settings: Any, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return encode_whole(rig, settings, tmp_path_factory.mktemp("whole") / "scene.dgs")


@pytest.fixture(scope="module")
def short_whole(rig: Path, tiny_settings: Any, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """With settings for where nothing is killed."""
    return encode_whole(rig, tiny_settings, tmp_path_factory.mktemp("short") / "scene.dgs")


def encode_whole(rig: Path, settings: Any, output: Path) -> bytes:
    encode(rig, output, settings, segment=SEGMENT, closed=True, threads=1)
    return output.read_bytes()


@pytest.fixture
def nodes() -> Iterator[Any]:
    """A head with one processor, and two more nodes with one each."""
    pytest.importorskip("ray", reason="ray is not installed")
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    for _ in range(2):
        cluster.add_node(num_cpus=1)
    yield cluster
    cluster.shutdown()


@pytest.fixture
def run(rig: Path, settings: Any, tmp_path: Path) -> Callable[..., bytes]:
    def run(cluster: str, *, settings: Any = settings, progress: Any = None, **options: Any) -> bytes:
        output = tmp_path / "scene.dgs"
        job = EncodeJob(rig, output, settings, segment=SEGMENT, closed=True, **options)
        encode_on_cluster(job, cluster, progress=progress)
        assert [path.name for path in tmp_path.iterdir()] == ["scene.dgs"]
        return output.read_bytes()

    return run


def task_processes(nodes: Any) -> list[int]:
    """The workers of this cluster that run a part now."""
    raylets = {process.process.pid for node in nodes.list_all_nodes() for process in node.all_processes["raylet"]}
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            if parent in raylets and (folder / "cmdline").read_bytes().startswith(b"ray::_task"):
                found.append(int(folder.name))
    return found


def test_a_killed_worker_costs_no_byte(nodes: Any, run: Any, whole: bytes) -> None:
    killed: list[int] = []
    told: list[tuple[int, int]] = []

    def kill(done: int, total: int) -> None:
        told.append((done, total))
        if done >= 3 and len(killed) < 2:
            for process in task_processes(nodes)[:1]:
                os.kill(process, signal.SIGKILL)
                killed.append(process)

    assert run(nodes.address, progress=kill) == whole
    assert killed
    assert [done for done, _ in told] == sorted(done for done, _ in told)
    assert told[-1][1] == len(MOMENTS)


def test_a_node_that_is_taken_away_costs_no_byte(nodes: Any, run: Any, whole: bytes) -> None:
    taken: list[Any] = []

    def take_away(done: int, _: int) -> None:
        if done >= 3 and not taken:
            taken.append(nodes.list_all_nodes()[-1])
            nodes.remove_node(taken[0], allow_graceful=False)

    assert run(nodes.address, progress=take_away) == whole
    assert taken


def test_ctrl_c_leaves_what_is_done(nodes: Any, run: Any, whole: bytes, tmp_path: Path) -> None:
    folder = tmp_path / "scene.dgs.parts"

    def interrupt(*_: int) -> None:
        if len(list(folder.glob("*.dgs"))) >= 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(nodes.address, progress=interrupt)
    there = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    assert "key.dgs" in there
    assert not (tmp_path / "scene.dgs").exists()
    with pytest.raises(UsageError, match=r"scene.dgs.parts: an encode that was cut off left it; `resume` goes on"):
        run(nodes.address)
    with pytest.raises(UsageError, match=r"scene.dgs.parts: its encode had another `seed`"):
        run(nodes.address, resume=True, seed=1)
    kept: list[bool] = []

    def look(*_: int) -> None:
        kept.append(all((folder / name).stat().st_mtime_ns == time for name, time in there.items()))

    assert run(nodes.address, resume=True, progress=look) == whole
    assert all(kept)


def test_from_a_machine_outside_the_cluster(run: Any, tiny_settings: Any, short_whole: bytes) -> None:
    """Through Ray's client server, as ray:// addresses one."""
    pytest.importorskip("ray", reason="ray is not installed")
    pytest.importorskip("grpc", reason="ray's client is not installed: ray[client]")
    from ray.cluster_utils import Cluster

    with closing(socket.create_server(("127.0.0.1", 0))) as free:
        port = free.getsockname()[1]
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 2, "ray_client_server_port": port})
    try:
        assert run(f"ray://127.0.0.1:{port}", settings=tiny_settings) == short_whole
    finally:
        cluster.shutdown()


def test_one_machine_is_a_cluster_too(run: Any, tiny_settings: Any, short_whole: bytes) -> None:
    pytest.importorskip("ray", reason="ray is not installed")
    assert run("local", settings=tiny_settings) == short_whole


def test_a_problem_that_stays_is_told_in_one_line(nodes: Any, rig: Path, settings: Any, tmp_path: Path) -> None:
    (tmp_path / "key.ply").write_bytes(b"no ply")
    job = EncodeJob(rig, tmp_path / "scene.dgs", settings, segment=SEGMENT, closed=True, keyframe=tmp_path / "key.ply")
    with pytest.raises(UsageError, match=r"key\.ply"):
        encode_on_cluster(job, nodes.address)
    assert not (tmp_path / "scene.dgs").exists()


# Without Ray


class Here:
    """Stands in for Ray: runs the parts one after the other, in this process."""

    notice = ""
    ran: ClassVar[list[range]] = []
    warnings: ClassVar[tuple[str, ...]] = ()

    def __init__(self, *_: Any, **__: Any) -> None:
        self.ran.clear()

    def __enter__(self) -> Here:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def run(self, job: EncodeJob, parts: Any, keyframe: bytes | None) -> Iterator[Any]:
        """And tells of frames done; once of fewer than before, as where a task begins again."""
        done = 0
        for part in parts:
            self.ran.append(part)
            yield part, replace(run_part(job, part, keyframe, lambda done: None), warnings=self.warnings)
            done += len(part)
            yield from (done, done - 1)


@pytest.fixture
def here(rig: Path, tiny_settings: Any, tmp_path: Path) -> Callable[..., list[str]]:
    """Encodes to scene.dgs without Ray; what was warned of."""

    def run(*, progress: Any = None, **options: Any) -> list[str]:
        told: list[str] = []
        given = {"segment": SEGMENT, "closed": True, "frames": slice(4)} | options
        job = EncodeJob(rig, tmp_path / "scene.dgs", tiny_settings, **given)
        encode_on_cluster(job, "local", progress=progress, on_warning=told.append, new_engine=Here)
        return told

    return run


def test_only_what_it_made_is_removed(here: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(Here, "warnings", ("it is dark",))
        assert here() == ["it is dark"] * 2, "once of the keyframe, and once of all parts"
    whole, folder = (tmp_path / "scene.dgs").read_bytes(), tmp_path / "scene.dgs.parts"
    assert not folder.exists()
    others = {"notes.txt": b"mine", "sub/take.mov": b"film", "6-8.dgs": b"mine, too", "0-2.dgs.bak": b"old"}
    for name, data in others.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    with pytest.raises(UsageError, match=r"scene.dgs.parts: parts are kept there, and it is not empty; move"):
        here()
    (told,) = here(resume=True)
    assert told == f"{folder}: it stays, since 0-2.dgs.bak in it is none of this encode's parts"
    assert {name: (folder / name).read_bytes() for name in others} == others
    assert sorted(path.name for path in folder.iterdir()) == ["0-2.dgs.bak", "6-8.dgs", "notes.txt", "sub"]
    assert (tmp_path / "scene.dgs").read_bytes() == whole


@pytest.mark.parametrize("name", ["key.dgs", "0-2.dgs", "2-4.dgs"])
@pytest.mark.parametrize("what", ["text", "a stream", "a folder", "a dangling link"])
@pytest.mark.parametrize("age", [0, -3600])
def test_what_only_has_the_name_of_a_part_stays(
    here: Any, moving: Any, tmp_path: Path, name: str, what: str, age: int
) -> None:
    """Older than the recordings, too: a part would then be made again."""
    path = tmp_path / "scene.dgs.parts" / name
    path.parent.mkdir()
    if what == "a folder":
        path.mkdir()
    elif what == "a dangling link":
        path.symlink_to("nowhere")
    else:
        path.write_bytes(b"mine" if what == "text" else moving.data)
        os.utime(path, (path.stat().st_mtime + age,) * 2)
    with pytest.raises(UsageError, match=rf"{name}: this is no part of a take, or it is damaged; move it away"):
        here(resume=True)
    assert os.path.lexists(path)
    assert what not in ("text", "a stream") or path.read_bytes() in (b"mine", moving.data)


def test_a_part_of_another_take_stays(here: Any, rig: Path, tiny_settings: Any, tmp_path: Path) -> None:
    """Although it has a part's name, and is older than the recordings, so that it would be made again."""
    other = tmp_path / "scene.dgs.parts" / "0-2.dgs"
    other.parent.mkdir()
    encode(rig, other, tiny_settings, frames=slice(6), only=range(2), segment=SEGMENT, closed=True, threads=1)
    data = other.read_bytes()
    os.utime(other, (0, 0))
    with pytest.raises(UsageError, match=r"0-2.dgs: it does not belong to .*key.dgs: it is a part of frames 0 to 5"):
        here(resume=True)
    assert other.read_bytes() == data


def test_what_is_there_is_left_out_unless_its_recordings_are_newer(
    here: Any, rig: Path, tiny_settings: Any, tmp_path: Path
) -> None:
    """And counts as done; progress never goes back."""
    folder, told = tmp_path / "scene.dgs.parts", []
    folder.mkdir()
    given: dict[str, Any] = {"frames": slice(6), "segment": SEGMENT, "closed": True, "threads": 1}
    key = folder / "key.dgs"
    encode(rig, key, tiny_settings, only=range(1), **given)
    for start in (0, 2):
        part = folder / f"{start}-{start + 2}.dgs"
        encode(rig, part, tiny_settings, only=range(start, start + 2), keyframe=key, **given)
    os.utime(part, (0, 0))
    here(resume=True, frames=slice(6), progress=lambda *done: told.append(done))
    assert Here.ran == [range(2, 4), range(4, 6)]
    assert told == [(4, 6), (4, 6), (6, 6), (6, 6)]


def test_an_older_keyframe_than_its_recordings_is_refused(
    here: Any, rig: Path, tiny_settings: Any, tmp_path: Path
) -> None:
    key = tmp_path / "scene.dgs.parts" / "key.dgs"
    key.parent.mkdir()
    encode(rig, key, tiny_settings, frames=slice(4), only=range(1), segment=SEGMENT, closed=True, threads=1)
    os.utime(key, (0, 0))
    with pytest.raises(UsageError, match=r"key.dgs: the first frame's recordings are newer; delete it and the parts"):
        here(resume=True)
    assert key.exists()


@pytest.mark.parametrize(
    "options", [{"frames": slice(6)}, {"holdout": ["cam02"]}, {"metrics": True}, {"seed": 1}, {"scale": 0.5}]
)
def test_what_is_there_of_other_options_is_refused(
    here: Any, rig: Path, tiny_settings: Any, tmp_path: Path, options: dict[str, Any]
) -> None:
    key = tmp_path / "scene.dgs.parts" / "key.dgs"
    key.parent.mkdir()
    encode(rig, key, tiny_settings, frames=slice(4), only=range(1), segment=SEGMENT, closed=True, threads=1)
    with pytest.raises(UsageError, match=rf"scene.dgs.parts: its encode had another `{next(iter(options))}`"):
        here(resume=True, **options)
    assert key.exists()


@pytest.fixture(scope="module")
def keyframes(rig: Path, tiny_settings: Any, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two streams of the first frame, and the first one's Gaussians as a file."""
    folder = tmp_path_factory.mktemp("keyframes")
    streams = [folder / "a.dgs", folder / "b.dgs"]
    for seed, path in enumerate(streams):
        encode(rig, path, tiny_settings, frames=slice(1), seed=seed, threads=1)
    export(streams[0], folder / "a.ply")
    return [*streams, folder / "a.ply"]


@pytest.mark.parametrize(("begun", "resumed"), [(0, 1), (None, 1), (2, 1), (2, None), (1, 2)])
def test_another_keyframe_than_that_of_the_parts_is_refused(
    here: Any, rig: Path, tiny_settings: Any, keyframes: list[Path], tmp_path: Path, begun: Any, resumed: Any
) -> None:
    given = [None if number is None else keyframes[number] for number in (begun, resumed)]
    key = tmp_path / "scene.dgs.parts" / "key.dgs"
    key.parent.mkdir()
    options: dict[str, Any] = {"frames": slice(4), "segment": SEGMENT, "closed": True, "threads": 1}
    encode(rig, key, tiny_settings, only=range(1), keyframe=given[0], **options)
    with pytest.raises(UsageError, match=r"scene.dgs.parts: its encode had another `keyframe`; give the same options"):
        here(resume=True, keyframe=given[1])
    assert not Here.ran
    here(resume=True, keyframe=given[0])
    assert Here.ran == [range(2), range(2, 4)]


def test_a_part_of_another_keyframe_stays(
    here: Any, rig: Path, tiny_settings: Any, keyframes: list[Path], tmp_path: Path
) -> None:
    """It is named before anything is encoded, not when all parts are joined."""
    other = tmp_path / "scene.dgs.parts" / "2-4.dgs"
    other.parent.mkdir()
    options: dict[str, Any] = {"frames": slice(4), "segment": SEGMENT, "closed": True, "threads": 1}
    for name, source in (("b.dgs", keyframes[1]), (other.with_name("key.dgs"), keyframes[0])):
        encode(rig, tmp_path / name, tiny_settings, only=range(1), keyframe=source, **options)
    encode(rig, other, tiny_settings, only=range(2, 4), keyframe=tmp_path / "b.dgs", **options)
    with pytest.raises(UsageError, match=r"2-4.dgs: it does not belong to .*key.dgs: it starts from another first key"):
        here(resume=True, keyframe=keyframes[0])
    assert (Here.ran, other.exists()) == ([], True)


def test_what_a_part_fails_of_is_told_in_one_line(here: Any, tmp_path: Path) -> None:
    (tmp_path / "key.ply").write_bytes(b"no ply")
    with pytest.raises(UsageError, match=r"key\.ply") as raised:
        here(keyframe=tmp_path / "key.ply")
    assert "\n" not in str(raised.value)
    assert not (tmp_path / "scene.dgs").exists()


def test_a_stream_to_be_resumed_is_not_joined_over(here: Any, moving: Any, tmp_path: Path) -> None:
    growing = tmp_path / "scene.dgs.part"
    growing.write_bytes(moving.data[:-100])
    with pytest.raises(UsageError, match=r"scene.dgs.part: a command that was cut off left it"):
        here()
    assert [path.name for path in tmp_path.iterdir()] == [growing.name], "said before anything is encoded"
    with pytest.raises(UsageError, match=r"scene.dgs.part: a command that was cut off left it"):
        here(resume=True)
    assert growing.read_bytes() == moving.data[:-100]
    growing.unlink()
    here(resume=True)
    whole = (tmp_path / "scene.dgs").read_bytes()
    growing.write_bytes(whole[:-100])
    here(resume=True)
    assert (tmp_path / "scene.dgs").read_bytes() == whole, "what a join left that was killed"
    assert not growing.exists()


def test_who_may_connect_to_ray_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ray has no setting to listen on this machine's own address alone."""
    monkeypatch.delenv("RAY_AUTH_MODE", raising=False)
    monkeypatch.setitem(sys.modules, "ray", SimpleNamespace(__version__="2.60.0"))
    told = RayEngine("local", threads=1, device="cpu").notice
    assert (
        told
        == "`cluster` local: Ray listens on this machine's network addresses meanwhile, for callers that have its token"
    )
    assert RayEngine("ray://head:10001", threads=1, device="cpu").notice == ""
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    assert "for everyone, by RAY_AUTH_MODE" in RayEngine("local", threads=1, device="cpu").notice
    for old in ("2.30.0", "2.51.1", "2.59.0rc1"):
        monkeypatch.setitem(sys.modules, "ray", SimpleNamespace(__version__=old))
        with pytest.raises(UsageError, match=f"`cluster`: Ray {old} takes tasks from everyone on the network"):
            RayEngine("local", threads=1, device="cpu")


def test_a_part_is_tried_three_times(monkeypatch: pytest.MonkeyPatch) -> None:
    """With what Ray is asked, and nothing of Ray: where its machine is full, where Ray has lost it."""
    full, good, lost = Outcome(problem="the disk is full", again=True), Outcome(b"a part"), OSError("node 3 died")
    outcomes = [full, lost, good, lost, lost, full]
    given: list[Any] = []

    def task(number: int, _: Any, *what: Any) -> Outcome | OSError:
        given.append((number, *what))
        return outcomes.pop(0)

    def get(value: Any, **_: Any) -> Any:
        if value is lost:
            raise lost
        return value

    def later(call: Callable[..., Any]) -> Any:
        return SimpleNamespace(remote=call)

    board = SimpleNamespace(frames=later(lambda: 1))
    ray = SimpleNamespace(
        __version__="2.60.0",
        init=lambda *_, **__: None,
        shutdown=lambda: None,
        remote=lambda **_: lambda what: later(task if what is ray_engine._task else lambda: board),
        put=lambda value: value,
        get=get,
        wait=lambda references, **_: (references, []),
        exceptions=SimpleNamespace(RayError=OSError, RayTaskError=ConnectionError),
    )
    monkeypatch.setitem(sys.modules, "ray", ray)
    job, part = EncodeJob("rig", "scene.dgs"), range(2, 4)
    with RayEngine("local", threads=1, device="cpu") as engine:
        assert list(engine.run(job, [part], b"key")) == [1, 1, (part, good), 1]
        with pytest.raises(TryAgainError, match=r"the disk is full \(tried 3 times\)"):
            list(engine.run(job, [part], b"key"))
    assert given == [(0, job, part, b"key")] * 6


def test_local_joins_no_cluster_of_somebody_else(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without an address Ray looks for one that runs, and its end would be the encode's."""
    ray = pytest.importorskip("ray", reason="ray is not installed")
    asked: list[Any] = []

    def init(*address: str, **_: Any) -> None:
        asked.extend(address)
        raise RuntimeError("not here")

    monkeypatch.setattr(ray, "init", init)
    with pytest.raises(TryAgainError, match="not here"), RayEngine("local", threads=1, device="cpu"):
        pass
    assert asked == ["local"]


def test_what_a_task_was_given_may_be_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ray says so with an error of the task; any other one is a fault of ours."""
    ray = pytest.importorskip("ray", reason="ray is not installed")
    engine = RayEngine("local", threads=1, device="cpu")
    errors = ray.exceptions
    for cause, again in ((errors.OwnerDiedError("00" * 28, None, ""), True), (ValueError("ours"), False)):

        def get(_: Any, cause: Exception = cause) -> None:
            raise errors.RayTaskError("task", "", cause).as_instanceof_cause()

        monkeypatch.setattr(ray, "get", get)
        if again:
            assert engine._outcome(None).again
        else:
            with pytest.raises(ValueError):  # noqa: PT011 (whatever Ray makes of the text)
                engine._outcome(None)


class Failing:
    """A rig's folder on a machine that fails."""

    def __init__(self, error: Exception) -> None:
        self._error = error

    def __fspath__(self) -> str:
        raise self._error


def test_an_outcome_says_whether_to_try_again(rig: Path, tiny_settings: Any, tmp_path: Path) -> None:
    rig = Path(shutil.copytree(rig, tmp_path / "rig"))
    cv2.imwrite(str(rig / "cam03" / "0001.png"), np.zeros((48, 64, 3), np.uint8))
    job = EncodeJob(str(rig), tmp_path / "part.dgs", replace(tiny_settings, segment=SEGMENT, closed=True), threads=1)
    told: list[int] = []
    outcome = run_part(job, range(1), None, told.append)
    assert (outcome.problem, outcome.again, told) == ("", False, [1])
    key = outcome.data
    assert key
    assert outcome.warnings == ()
    second = run_part(job, range(2), None, told.append)
    assert second.data
    assert second.warnings == ("camera cam03 was left out of frame 1: its picture is black",)
    told.clear()
    assert run_part(job, range(2, 4), key, told.append).data
    assert told == [1, 2], "the keyframe is none of the part's frames"
    lacking = run_part(job, range(2, 4), None, told.append)
    assert "parts after the first start from its keyframe" in lacking.problem
    assert not lacking.again

    for error in (
        TryAgainError("the disk is full"),
        OSError("no space left"),
        MemoryError("out of memory"),
        MemoryError(),
    ):
        gone = replace(job, rig=Failing(error))  # type: ignore[arg-type]
        assert run_part(gone, range(1), None, told.append) == Outcome(problem=str(error) or "out of memory", again=True)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--cluster", "local"], "--cluster: tasks are closed segments; add --segment and --closed"),
        (["--cluster", "here", "--segment", "2", "--closed"], "--cluster here: give local, or ray://HOST:PORT"),
        (["--cluster", "local", "--segment", "2", "--closed", "--only", "0:1"], "it does not go with --only 0:1"),
        (["--cluster", "local", "--segment", "2", "--closed", "--log", "x"], "it does not go with --log x"),
    ],
)
def test_options_that_no_cluster_takes(
    rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str], message: str
) -> None:
    assert encode_main([str(rig), "-o", str(tmp_path / "scene.dgs"), *more]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_the_command_says_what_was_made(rig: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    made = SimpleNamespace(parts=4, frames=8, total_bytes=99)
    monkeypatch.setattr("decogs.encoder.cluster.encoding.encode_on_cluster", lambda *_, **__: made)
    assert encode_main([str(rig), "-o", "scene.dgs", "--cluster", "local", "--segment", "2", "--closed", "-q"]) == 0
    assert capsys.readouterr().out == "scene.dgs: 4 parts, 8 frames, 99 bytes\n"


def test_ray_is_asked_for_where_it_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(UsageError, match=r"`cluster`: Ray is not installed; pip install 'ray\[client\]>=2.60'"):
        RayEngine("local", threads=1, device="cpu")
