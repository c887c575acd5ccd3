"""Which bytes of a file a Range header asks for (RFC 9110, section 14)."""

from __future__ import annotations

import re

_RANGE = re.compile(r"bytes=[ \t]*(\d{0,18})-(\d{0,18})[ \t]*", re.ASCII | re.IGNORECASE)


class NoSuchBytes(Exception):
    """The range lies outside the file."""


def asked_range(header: str | None, size: int) -> range | None:
    """The bytes asked for of a file of ``size``; None for all of it.

    What is not understood, several ranges included, asks for all of it, as the RFC allows. Raises NoSuchBytes.
    """
    match = _RANGE.fullmatch(header or "")
    if match is None or match[1] == match[2] == "":
        return None
    first, last = match.groups()
    if first == "":
        start, stop = max(0, size - int(last)), size
    else:
        start, stop = int(first), size if last == "" else min(size, int(last) + 1)
        if last != "" and int(last) < start:
            return None
    if start >= stop:
        raise NoSuchBytes
    return range(start, stop)
