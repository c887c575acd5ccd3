"""Files that a command writes: none that it reads, no two in one place, each whole under its name or not there.

A file grows beside its name, as ``NAME.part``, locked (flock) by the process that writes it, is flushed to the
disk and then renamed. Every file that our own code writes goes through `GrowingFile`; pictures, videos and USD are
written by libraries, which want a name: in a folder, or under a name, of their own, and are moved. What is asked for is
compared before anything is opened (`check_outputs`): by device and inode where a file is there, by its resolved path
where not, so that links and other spellings of a name are seen through. A file of another format is never replaced,
and no name is given whose ending means another format.
"""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Literal

from ..errors import TryAgainError, UsageError
from ..stream.container import SIGNATURE
from ..system.operating_systems import AS_THEY_ARE, CLOSES_FIRST, NO_LINKS, WITHOUT_WAITING, take_lock

Leftover = Literal["refused", "kept", "dropped"]
"""What becomes of the ``NAME.part`` that an interrupted process left: an error, continued, or replaced."""

Expendable = Callable[[Path], bool]
"""Whether the ``NAME.part`` that is there may be replaced, since nobody would go on with it; refused otherwise."""

_Identity = tuple[int, int] | str

ENDINGS = frozenset({
    ".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".mxf", ".ts", ".m2ts", ".mts", ".mpg", ".mpeg", ".wmv", ".y4m",
    ".yuv", ".rgb", ".wav", ".w64", ".mp3", ".m4a", ".aac", ".flac", ".ogg", ".opus", ".aiff", ".caf", ".ac3", ".eac3",
    ".wma", ".au", ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".heic", ".webp", ".bmp", ".dpx", ".hdr", ".gif",
    ".dgs", ".ply", ".spz", ".sog", ".splat", ".glb", ".gltf", ".obj", ".fbx", ".abc", ".usd", ".usda", ".usdc",
    ".usdz", ".blend", ".npy", ".npz", ".h5", ".zip", ".tar", ".gz", ".pdf", ".toml", ".yaml", ".yml", ".json",
    ".jsonl", ".txt", ".csv", ".xml", ".html", ".md", ".py",
})  # fmt: skip
"""Endings that say what a file holds."""

_FIRST_BYTES = 64

_ABOUT_TO_BE_LOCKED = 2.0
"""Seconds after a file was made in which its maker may not have locked it yet."""


@dataclass(frozen=True)
class FileFormat:
    """What a command writes: what it is called, the endings that it may have, and how a file of it ``begins``."""

    name: str
    endings: frozenset[str]
    begins: tuple[bytes, ...]


STREAM = FileFormat("a .dgs stream", frozenset({".dgs"}), (SIGNATURE,))
JSON = FileFormat("JSON", frozenset({".json", ".jsonl", ".txt"}), (b"{", b"["))
PNG = FileFormat("a PNG picture", frozenset({".png"}), (b"\x89PNG",))


@dataclass(frozen=True)
class Output:
    """Something to be written: the parameter that asks for it and the file; ``grows``: beside its name first.

    ``format``: what it holds, where its name may have another ending and a file of another format be there.
    """

    parameter: str
    file: Path | BinaryIO
    grows: bool = False
    format: FileFormat | None = None

    @property
    def identities(self) -> list[tuple[str, _Identity]]:
        """Every file that is written on the way, as it is called and as it is compared."""
        if not isinstance(self.file, Path):
            identity = _identity_of_open(self.file)
            return [] if identity is None else [("-", identity)]
        if is_device(self.file):
            return []
        paths = [self.file, part_of(self.file)] if self.grows else [self.file]
        return [(str(path), _identity(path)) for path in paths]


def files_read(**read: object) -> list[tuple[Path, str]]:
    """Those of the parameters that are files, or open ones that lie on a disk, and what each is called."""
    files = []
    for name, file in read.items():
        if isinstance(file, (str, os.PathLike)):
            files.append((Path(file), f"is read, as `{name}`"))
        elif hasattr(file, "fileno"):
            with suppress(OSError):  # as it lies in memory
                files.append((Path(f"/dev/fd/{file.fileno()}"), f"is read, as `{name}`"))
    return files


def check_outputs(outputs: Sequence[Output], inputs: Iterable[tuple[Path, str]]) -> None:
    """Raises UsageError when an output would be written over an input, over another output or a file of another format.

    ``inputs``: each file that is read, and what it is called.
    """
    taken: dict[_Identity, str] = {}
    existing = {identity for output in outputs for _, identity in output.identities if isinstance(identity, tuple)}
    # A rig can have a hundred thousand pictures: they are looked at only where an output is an existing file.
    for path, called in inputs if existing else ():
        if (read := _identity(path)) in existing:
            taken.setdefault(read, called)
    for output in outputs:
        identities = output.identities
        for name, identity in identities:
            if identity in taken:
                raise UsageError(f"`{output.parameter}` {name}: {taken[identity]}; name another file")
        taken |= {identity: f"`{output.parameter}` is written there, too" for _, identity in identities}
    for output in outputs:
        if output.format is not None and isinstance(output.file, Path) and not is_device(output.file):
            _check_format(output.parameter, output.file, output.format)


def check_folder_name(folder: Path) -> None:
    """Raises UsageError for a folder to write that is a file, or would get a name with the ending of one."""
    if folder.is_dir():
        return
    if folder.exists():
        raise UsageError(f"{folder}: is a file; name a folder")
    if folder.suffix.lower() in ENDINGS:
        raise UsageError(f"{folder}: {folder.suffix} ends the name of a file, and a folder is written; rename it")


def _check_format(parameter: str, path: Path, format: FileFormat) -> None:
    for ending in (path.suffix.lower(), resolved(path).suffix.lower()):
        if ending in ENDINGS - format.endings:
            raise UsageError(
                f"`{parameter}` {path}: {ending} is another format, and {format.name} is written; rename it"
            )
    if not path.is_file() or not path.stat().st_size:
        return
    with path.open("rb") as file:
        begins = file.read(_FIRST_BYTES).lstrip()
    if not begins.startswith(format.begins):
        raise UsageError(
            f"`{parameter}` {path}: a file is there that is not {format.name}, and is not replaced; name another file"
        )


@contextmanager
def errors_named(name: str) -> Iterator[None]:
    """What a disk, a pipe or a device does not take is said with the name of what was written there."""
    try:
        yield
    except OSError as error:
        error.filename = name
        raise


def part_of(output: Path) -> Path:
    """The file that an output grows in: beside the file that ``output`` names, through symbolic links."""
    target = resolved(output)
    return target.parent / f"{target.name}.part"  # "." and "/" have no name; they are refused as folders


def resolved(output: Path) -> Path:
    """The path as it is given, unless it is a symbolic link: then what that points to, be it there or not."""
    return Path(os.path.realpath(output)) if output.is_symlink() else output


def is_device(path: Path) -> bool:
    """Whether it is there and takes bytes but is no file that could be replaced: a named pipe, /dev/null, a socket."""
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def is_left_over(part: Path) -> bool:
    """Whether a file that grows is empty and nobody writes it: its process was killed before its first byte."""
    with suppress(OSError), part.open("rb") as file:
        status = os.fstat(file.fileno())
        # One that was made just now may be about to be locked by its maker, whom a lock of ours would turn away.
        if status.st_size or time.time() - status.st_mtime < _ABOUT_TO_BE_LOCKED:
            return False
        take_lock(file.fileno(), shared=True)
        return True
    return False


class GrowingFile:
    """A file that nobody else writes, which gets its name when it is whole; a context manager.

    ``file``: ``NAME.part``, locked and open for reading and writing, at its beginning. Leaving the block without
    ``publish`` closes it; what it holds by then stays, an empty one is removed.
    """

    def __init__(self, output: Path, *, leftover: Leftover | Expendable = "refused", resumable: bool = True) -> None:
        """Raises UsageError for what cannot be written or is being written; ``resumable``: whether that advises it."""
        self.output, self.path = resolved(output), part_of(output)
        self._check()
        self.file = self._locked()
        if callable(leftover):
            leftover = "dropped" if self.size and leftover(self.path) else "refused"
        if leftover == "dropped":
            self.file.truncate(0)
        elif leftover == "refused" and self.size:
            self.file.close()
            self._refuse(
                self.path,
                "an encode that was cut off left it; `resume` goes on with it, or delete it to start over"
                if resumable
                else "a command that was cut off left it; delete it, unless an encode is to go on with it",
            )

    @property
    def size(self) -> int:
        """Bytes that it holds, those that were flushed."""
        return os.fstat(self.file.fileno()).st_size

    def publish(self) -> None:
        """Gives it its name, once it is on the disk; a power cut leaves the old file or the whole new one."""
        self.file.flush()
        os.fsync(self.file.fileno())
        if CLOSES_FIRST:
            self.file.close()
        os.replace(self.path, self.output)
        _sync_folder(self.output.parent)
        self.file.close()

    def discard(self) -> None:
        """Removes what there is of it, while it is still locked."""
        self._remove()
        self.release()

    def release(self) -> None:
        """Closes it; what it holds stays, as ``NAME.part``."""
        if self.file.closed:
            return
        # What the disk did not take was reported when it was written.
        with suppress(OSError):
            self.file.flush()
        if not self.size:
            self._remove()
        with suppress(OSError):
            self.file.close()

    def _remove(self) -> None:
        if CLOSES_FIRST:
            self.file.close()
        self.path.unlink(missing_ok=True)

    def __enter__(self) -> GrowingFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    def _check(self) -> None:
        if self.output.is_dir():
            self._refuse(self.output, f"is a folder; name a file in it, such as {self.output / 'scene.dgs'}")
        if not self.output.parent.is_dir():
            self._refuse(self.output.parent, "no such folder; create it first")
        if not os.access(self.output.parent, os.W_OK):
            self._refuse(self.output.parent, "cannot be written to; choose another folder")

    def _locked(self) -> BinaryIO:
        while True:
            try:
                # No link is followed and no named pipe waited for: neither is the file that this one grows in.
                number = os.open(self.path, os.O_RDWR | os.O_CREAT | NO_LINKS | WITHOUT_WAITING | AS_THEY_ARE, 0o666)
            except OSError as error:
                self._refuse(self.path, f"{error.strerror}, and the file grows there; choose another name, or clear it")
            if not stat.S_ISREG(os.fstat(number).st_mode):
                os.close(number)
                self._refuse(self.path, "is no regular file, and the file grows there; choose another name")
            file = os.fdopen(number, "r+b")
            try:
                _lock(number)
            except BlockingIOError:
                file.close()
                raise TryAgainError(
                    f"{self.path}: another process is writing it; wait for its end, or choose another name"
                ) from None
            if _identity(self.path) == _identity_of_open(file):
                return file
            file.close()  # The other one was done and gave it its name between the two steps.

    def _refuse(self, path: Path, problem: str) -> None:
        raise UsageError(f"{path}: {problem}")


def write_whole(path: Path, data: bytes, *, expendable: Expendable | None = None) -> None:
    """Writes the file so that an interruption leaves the one that was there, or none. Raises UsageError, OSError.

    ``expendable``: what may be replaced of what is there in ``NAME.part``; None is all but a stream.
    """
    with GrowingFile(path, leftover=expendable or _is_no_stream, resumable=False) as growing:
        try:
            growing.file.write(data)
            growing.publish()
        except OSError:
            growing.discard()
            raise


@contextmanager
def staged_files(folder: Path) -> Iterator[Path]:
    """A hidden folder beside ``folder`` to write files into, all of which are moved there when the block ends well.

    Folders that are missing are made then. Otherwise nothing is left. Raises UsageError for what cannot be written.
    """
    try:
        staging = Path(tempfile.mkdtemp(prefix=".decogs-", dir=_existing_folder(folder)))
    except OSError as error:
        raise UsageError(f"{folder}: cannot be written to ({error.strerror}); choose another output") from None
    try:
        yield staging
        publish_files(staging, folder)
    except OSError as error:
        error.filename = _final_name(error.filename, staging, folder)
        raise
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _final_name(name: object, staging: Path, folder: Path) -> object:
    """What the user knows a file by that an error is about: the hidden folder is none of the names given."""
    if name is None:
        return os.fspath(folder)
    if isinstance(name, str) and Path(name).is_relative_to(staging):
        return os.fspath(folder / Path(name).relative_to(staging))
    return name


def publish_files(staging: Path, folder: Path) -> None:
    """Moves what is in ``staging`` into ``folder``, made if it is missing. Raises UsageError where that fails."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file in sorted(staging.iterdir()):
            os.replace(file, folder / file.name)
    except OSError as error:
        raise UsageError(f"{folder}: cannot be written to ({error.strerror}); choose another output") from None


def open_in_place(path: Path, *, append: bool = False) -> BinaryIO:
    """A text that others read while its lines are written: locked, and emptied or, by ``append``, continued.

    Raises UsageError when another process is writing it, OSError when it cannot be written.
    """
    if is_device(path):
        return path.open("wb")
    number = os.open(path, os.O_RDWR | os.O_CREAT | AS_THEY_ARE, 0o666)
    file = os.fdopen(number, "r+b")
    try:
        _lock(number)
    except BlockingIOError:
        file.close()
        raise UsageError(f"{path}: another process is writing it; name another file") from None
    if not append:
        file.truncate()
    elif file.seek(0, os.SEEK_END):
        file.seek(-1, os.SEEK_END)
        if file.read(1) != b"\n":
            file.write(b"\n")  # What was cut off stays a line of its own.
    return file


def check_writable(path: Path) -> None:
    """Raises UsageError, before anything long is done, for a file that `write_whole` could not write."""
    GrowingFile(path, leftover=_is_no_stream, resumable=False).release()


def _is_no_stream(part: Path) -> bool:
    """Whether a file that grows holds none of the streams that an encode may be to go on with."""
    with part.open("rb") as file:
        return file.read(len(SIGNATURE)) != SIGNATURE


def _lock(number: int) -> None:
    """Takes the lock of an open file; BlockingIOError when another process has it."""
    try:
        take_lock(number)
    except BlockingIOError:
        raise
    except OSError:
        pass  # Some network file systems have no locks.


def _existing_folder(folder: Path) -> Path:
    """The folder itself or its nearest ancestor that exists: the same disk, so that files can be renamed into place."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder


def _sync_folder(folder: Path) -> None:
    """Brings a new name to the disk, where the file system can."""
    with suppress(OSError):
        number = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


def _identity(path: Path) -> _Identity:
    """Which file it is: equal for all its names."""
    try:
        status = path.stat()
    except OSError:
        return os.path.realpath(path)
    return status.st_dev, status.st_ino


def _identity_of_open(file: BinaryIO) -> _Identity | None:
    try:
        status = os.fstat(file.fileno())
    except (OSError, AttributeError):  # io.UnsupportedOperation is an OSError: it lies in memory.
        return None
    return (status.st_dev, status.st_ino) if stat.S_ISREG(status.st_mode) else None
