"""Outputs: never over an input, no two in one place, one writer, whole under their name or not there."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from decogs.formats.errors import UsageError
from decogs.formats.files.outputs import (
    JSON,
    STREAM,
    GrowingFile,
    Output,
    check_folder_name,
    check_outputs,
    check_writable,
    open_in_place,
    part_of,
    staged_files,
    write_whole,
)
from decogs.formats.stream.container import SIGNATURE


def itself(path: Path) -> Path:
    return path


def by_another_spelling(path: Path) -> Path:
    (path.parent / "sub").mkdir()
    return path.parent / "sub" / ".." / path.name


def by_symbolic_link(path: Path) -> Path:
    link = path.with_name("link")
    link.symlink_to(path)
    return link


def by_hard_link(path: Path) -> Path:
    link = path.with_name("other")
    link.hardlink_to(path)
    return link


@pytest.mark.parametrize("named", [itself, by_another_spelling, by_symbolic_link, by_hard_link])
def test_an_input_is_known_by_all_its_names(tmp_path: Path, named: Callable[[Path], Path]) -> None:
    path = tmp_path / "cam.mp4"
    path.write_bytes(b"film")
    with pytest.raises(UsageError, match=r"`log` .*: holds frames; name another file"):
        check_outputs([Output("log", named(path))], [(path, "holds frames")])


def test_two_outputs_in_one_place_are_refused_be_they_there_or_not(tmp_path: Path) -> None:
    stream, log = Output("output", tmp_path / "a.dgs", grows=True), Output("log", tmp_path / "log")
    check_outputs([stream, log], [])
    for name in ("a.dgs", "a.dgs.part"):
        with pytest.raises(UsageError, match=rf"`convergence_log` .*{name}: `output` is written there, too"):
            check_outputs([stream, log, Output("convergence_log", tmp_path / name)], [])
    with pytest.raises(UsageError, match=r"`convergence_log` .*log: `log` is written there, too"):
        check_outputs([stream, log, Output("convergence_log", tmp_path / "log")], [])
    (tmp_path / "a.dgs.part").write_bytes(b"film")
    with pytest.raises(UsageError, match=r"`output` .*a\.dgs\.part: holds frames"):
        check_outputs([stream], [(tmp_path / "a.dgs.part", "holds frames")])


def test_an_open_file_counts_and_devices_may_be_named_twice(tmp_path: Path) -> None:
    with (
        (tmp_path / "out").open("wb") as piped,
        pytest.raises(UsageError, match=r"`log` .*out: `output` is written there"),
    ):
        check_outputs([Output("output", piped), Output("log", tmp_path / "out")], [])
    null = Path(os.devnull)
    check_outputs([Output("log", null), Output("convergence_log", null)], [])


@pytest.mark.parametrize(
    "name", ["film.mp4", "FILM.MOV", "scene.ply", "notes.txt", "rig.json", "scene.dgs.zip", "link"]
)
def test_a_stream_gets_no_name_of_another_format(tmp_path: Path, name: str) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "film.mp4")
    with pytest.raises(UsageError, match=rf"`output` .*{name}: \.\w+ is another format, and a \.dgs stream is written"):
        check_outputs([Output("output", tmp_path / name, grows=True, format=STREAM)], [])


@pytest.mark.parametrize("name", ["a.dgs", "A.DGS", "a", "a.v2", "a.dgs.old"])
def test_only_a_stream_is_replaced_by_a_stream(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    output = Output("output", path, grows=True, format=STREAM)
    check_outputs([output], [])
    for replaced in (b"", SIGNATURE + b"more"):
        path.write_bytes(replaced)
        check_outputs([output], [])
    for kept in (b"film", SIGNATURE[:-1], b"{}"):
        path.write_bytes(kept)
        with pytest.raises(UsageError, match=r"a file is there that is not a \.dgs stream, and is not replaced"):
            check_outputs([output], [])


def test_a_log_replaces_json_alone(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.write_bytes(b'\n {"event": 1}')
    check_outputs([Output("log", log, format=JSON)], [])
    log.write_bytes(b"dear diary")
    with pytest.raises(UsageError, match=r"`log` .*log: a file is there that is not JSON"):
        check_outputs([Output("log", log, format=JSON)], [])


def test_no_folder_gets_the_name_of_a_file(tmp_path: Path) -> None:
    for name in ("new", "take.1", "there.mp4"):
        (tmp_path / "there.mp4").mkdir(exist_ok=True)
        check_folder_name(tmp_path / name)
    (tmp_path / "file").touch()
    for name, said in (("sync.json", r"\.json ends the name of a file"), ("file", "is a file; name a folder")):
        with pytest.raises(UsageError, match=said):
            check_folder_name(tmp_path / name)


def test_a_growing_file_has_one_writer_until_it_has_its_name(tmp_path: Path) -> None:
    path = tmp_path / "scene"
    path.write_bytes(b"old")
    with GrowingFile(path) as growing:
        growing.file.write(b"new")
        assert path.read_bytes() == b"old"
        for leftover in ("refused", "kept", "dropped"):
            with pytest.raises(UsageError, match=r"scene\.part: another process is writing it"):
                GrowingFile(path, leftover=leftover)
        growing.publish()
    assert path.read_bytes() == b"new"
    assert [entry.name for entry in tmp_path.iterdir()] == ["scene"]
    GrowingFile(path).release()


def test_what_was_left_is_refused_kept_or_dropped(tmp_path: Path) -> None:
    path, part = tmp_path / "scene", tmp_path / "scene.part"
    part.write_bytes(b"half")
    with pytest.raises(UsageError, match=r"scene\.part: an encode that was cut off left it; `resume` goes on with it"):
        GrowingFile(path)
    with GrowingFile(path, leftover="kept") as growing:
        assert growing.file.read() == b"half"
    assert part.read_bytes() == b"half"
    with GrowingFile(path, leftover="dropped") as growing:
        assert growing.size == 0
    assert list(tmp_path.iterdir()) == [], "an empty one is nothing worth keeping"
    part.write_bytes(b"")
    GrowingFile(path).release()


def test_the_lock_of_a_file_that_got_its_name_meanwhile_is_not_enough(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another encode renames between our opening of ``.part`` and our lock: what we hold is its finished file."""
    path, real = tmp_path / "scene", os.open

    def overtaken(file: os.PathLike[str], *arguments: int) -> int:
        number = real(file, *arguments)
        if not path.exists():
            os.replace(file, path)
        return number

    monkeypatch.setattr(os, "open", overtaken)
    with GrowingFile(path) as growing:
        growing.file.write(b"ours")
        growing.file.flush()
        assert path.read_bytes() == b""
        assert part_of(path).read_bytes() == b"ours"


def test_a_symbolic_link_stays_and_its_file_is_written(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    link, target = tmp_path / "link", tmp_path / "disk" / "scene"
    link.symlink_to(target)
    for data in (b"new", b"newer"):
        write_whole(link, data)
        assert (link.is_symlink(), target.read_bytes()) == (True, data)
    assert part_of(link) == tmp_path / "disk" / "scene.part"


def test_a_full_disk_is_said_with_the_name_that_was_given(tmp_path: Path) -> None:
    def fails(name: Path | None) -> None:
        with staged_files(tmp_path / "site") as staging:
            error = OSError(28, "No space left on device")
            error.filename = None if name is None else os.fspath(staging / name)
            raise error

    for name, expected in ((None, "site"), (Path("a/x.exr"), "site/a/x.exr"), (tmp_path / "else", "else")):
        with pytest.raises(OSError, match="No space left") as raised:
            fails(name)
        assert raised.value.filename == str(tmp_path / expected)
    assert list(tmp_path.iterdir()) == []


def test_a_stream_that_grows_is_no_rest_of_another_file(tmp_path: Path) -> None:
    part = tmp_path / "scene.dgs.part"
    part.write_bytes(SIGNATURE + b"half")
    for write in (lambda: write_whole(tmp_path / "scene.dgs", b"new"), lambda: check_writable(tmp_path / "scene.dgs")):
        with pytest.raises(UsageError, match=r"scene\.dgs\.part: a command that was cut off left it"):
            write()
    assert part.read_bytes() == SIGNATURE + b"half"
    part.write_bytes(b'{"torn')
    write_whole(tmp_path / "scene.dgs", b"new")
    assert [path.name for path in tmp_path.iterdir()] == ["scene.dgs"]


def folder(part: Path) -> None:
    part.mkdir()


def link(part: Path) -> None:
    part.symlink_to(part.with_name("mine"))


def fifo(part: Path) -> None:
    os.mkfifo(part)


@pytest.mark.parametrize("there", [folder, link, fifo])
def test_a_place_that_cannot_be_grown_in_is_said_at_once(tmp_path: Path, there: Callable[[Path], None]) -> None:
    there(tmp_path / "scene.part")
    with pytest.raises(UsageError, match=r"scene\.part: .*the file grows there"):
        GrowingFile(tmp_path / "scene")
    with pytest.raises(UsageError, match="File name too long"):
        GrowingFile(tmp_path / ("x" * 252))


def test_bytes_are_on_the_disk_before_the_name_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []
    sync, rename = os.fsync, os.replace

    def fsync(number: int) -> None:
        done.append("sync")
        sync(number)

    def replace(*names: Path) -> None:
        done.append("rename")
        rename(*names)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "replace", replace)
    write_whole(tmp_path / "scene", b"new")
    assert done == ["sync", "rename", "sync"], "the file, its name, the folder that has the name"


def test_a_log_is_begun_anew_or_gone_on_with_and_has_one_writer(tmp_path: Path) -> None:
    path = tmp_path / "log"
    for append, data, expected in (
        (False, b"1\n", b"1\n"),
        (True, b"2\n{torn", b"1\n2\n{torn"),
        (True, b"3\n", b"1\n2\n{torn\n3\n"),
        (False, b"4\n", b"4\n"),
    ):
        with open_in_place(path, append=append) as file:
            with pytest.raises(UsageError, match="log: another process is writing it"):
                open_in_place(path)
            file.write(data)
        assert path.read_bytes() == expected
    with open_in_place(Path(os.devnull)) as one, open_in_place(Path(os.devnull)) as two:
        assert one.write(b"x") == two.write(b"x") == 1
