"""Files that can be read again, and then are the same: no named pipe, no device, no folder, none that changed."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO, NoReturn

from ..errors import UsageError
from ..system.operating_systems import AS_THEY_ARE, WITHOUT_WAITING


def open_regular(path: Path, buffering: int = -1) -> BinaryIO:
    """Opens a regular file for reading; raises OSError for anything else, without waiting for a named pipe's writer."""
    number = os.open(path, os.O_RDONLY | WITHOUT_WAITING | AS_THEY_ARE)
    mode = os.fstat(number).st_mode
    if not stat.S_ISREG(mode):
        os.close(number)
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), os.fspath(path))
        raise OSError(errno.EINVAL, "this is no regular file", os.fspath(path))
    return os.fdopen(number, "rb", buffering)


class Unchanged:
    """Whether an open file of this name still is what it was; ``grows``: whether it may get longer meanwhile."""

    def __init__(self, file: BinaryIO, path: Path) -> None:
        self._file, self._path, self.grows = file, path, False
        self._was = os.fstat(file.fileno())

    def check(self) -> None:
        """Raises UsageError where somebody has written into it."""
        now = os.fstat(self._file.fileno())
        longer = self.grows and now.st_size >= self._was.st_size
        if not longer and (now.st_size, now.st_mtime_ns) != (self._was.st_size, self._was.st_mtime_ns):
            self._refuse()

    def check_name(self) -> None:
        """Raises UsageError also where another file has its name by now, which somebody may have read in its place."""
        self.check()
        if not os.path.samestat(os.stat(self._path), self._was):
            self._refuse()

    def _refuse(self) -> NoReturn:
        raise UsageError(f"{self._path}: changed while it was read; try again when nobody writes it")
