"""Files that can be read again from their beginning: no named pipe, no device, no folder."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

from .operating_systems import AS_THEY_ARE, WITHOUT_WAITING


def open_regular(path: Path) -> BinaryIO:
    """Opens a regular file for reading; raises OSError for anything else, without waiting for a named pipe's writer."""
    number = os.open(path, os.O_RDONLY | WITHOUT_WAITING | AS_THEY_ARE)
    if not stat.S_ISREG(os.fstat(number).st_mode):
        os.close(number)
        raise OSError(errno.EINVAL, "this is no regular file", os.fspath(path))
    return os.fdopen(number, "rb")
