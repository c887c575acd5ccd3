"""A stream played from Python: in a notebook beneath the cell, otherwise in a browser."""

from __future__ import annotations

import os
import sys
from contextlib import ExitStack
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from decogs.formats.files.regular_files import open_regular

from ..limits import DEFAULT_MAX_MEMORY
from ..reading.following import DEFAULT_IDLE

if TYPE_CHECKING:
    from decogs.codec.header.header import StreamHeader

    from .piped import PipedStream
    from .server import StreamServer


class View:
    """A stream that is being served at ``url``, until ``close``; a context manager. A notebook shows it inline."""

    def __init__(
        self, server: StreamServer, name: str, width: int | str, height: int, piped: PipedStream | None = None
    ) -> None:
        self._server, self.name, self._width, self._height = server, name, width, height
        self._piped = piped
        if piped is not None:
            piped.go_on(server.close)

    @property
    def url(self) -> str:
        """Where a browser on this machine finds it."""
        return self._server.url

    def close(self) -> None:
        """Ends the server; what a browser has loaded stays there."""
        self._server.close()
        if self._piped is not None:
            self._piped.close()

    def wait(self) -> None:
        """Returns when it is closed: Ctrl-C, or another thread's ``close``. OSError where the disk took no more."""
        self._server.wait()
        if self._piped is not None and self._piped.error is not None:
            raise self._piped.error

    def __enter__(self) -> View:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"View({self.url!r})"

    def _repr_html_(self) -> str:
        """What IPython shows for the value of a cell."""
        size = f'width="{escape(str(self._width))}" height="{self._height}"'
        return (
            f'<iframe src="{escape(self.url)}" title="{escape(self.name)}" {size} style="border: 0" '
            'allow="fullscreen; clipboard-write"></iframe>'
        )


def view(
    stream: str | os.PathLike[str] | BinaryIO,
    *,
    port: int = 0,
    follow: bool = False,
    browser: bool | None = None,
    width: int | str = "100%",
    height: int = 540,
    idle: float = DEFAULT_IDLE,
    rig: str | os.PathLike[str] | None = None,
) -> View:
    """Plays a stream: a server of this machine begins, and a notebook's cell or the browser shows its page.

    ``port``: 0 takes one that is free. ``follow``: the stream is still being written; ``stream`` may then be its name
    or ``NAME.part``, and what is there is played until it is whole. ``browser``: whether to open one; None does where
    there is a screen and no notebook. ``width`` and ``height``: in a notebook, pixels or, for the width, a share such
    as "100%". ``idle``: seconds that a stream that is followed is waited for. ``rig``: the folder that it was encoded
    from; what its cameras recorded can then be laid beside their views. A ``stream`` that is an open file is a pipe,
    such as ``sys.stdin.buffer``, and is followed.

    The server knows this stream, that rig's frames and nothing else, is bound to 127.0.0.1, and lives until ``close``
    or the end of Python. Raises UsageError, StreamError for what is no readable stream, RigError for what is no rig,
    OSError when the file cannot be read.
    """
    from ..reading.following import followed
    from .piped import PipedStream
    from .recorded_pictures import RecordedPictures
    from .server import serve_stream

    with ExitStack() as unless_served:
        if isinstance(stream, (str, os.PathLike)):
            piped, path = None, followed(stream) if follow else Path(stream)
            header = check_header(stream, follow=follow, idle=idle)
        else:
            piped = unless_served.enter_context(PipedStream(stream))
            path, header, follow = piped.path, piped.header, True
        recordings = None if rig is None else RecordedPictures(rig, header)
        server = serve_stream(path, port=port, follow=follow, recordings=recordings)
        unless_served.pop_all()
    if has_screen() and not in_notebook() if browser is None else browser:
        open_browser(server.url)
    return View(server, path.name, width, height, piped)


def check_header(stream: str | os.PathLike[str], *, follow: bool, idle: float = DEFAULT_IDLE) -> StreamHeader:
    """The header. Raises StreamError, UsageError or OSError for what the page could not open; not for later damage.

    ``follow``: waits up to ``idle`` seconds for the file and its header.
    """
    from ..reading.following import GrowingStream, follow_stream, followed

    if follow:
        with follow_stream(followed(stream), idle=idle) as growing:
            return growing.header
    with open_regular(Path(stream)) as file:
        opened = GrowingStream(
            file, str(stream), idle=None, strict=False, on_damage=None, max_memory=DEFAULT_MAX_MEMORY
        )
        return opened.header


def has_screen() -> bool:
    """Whether a browser would have a window. Without a screen Python would start one that takes over the terminal."""
    return sys.platform == "darwin" or any(name in os.environ for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))


def open_browser(url: str) -> bool:
    """Shows the page in the user's browser; whether one was found."""
    import webbrowser

    try:
        return webbrowser.open(url)
    except webbrowser.Error:
        return False


def in_notebook() -> bool:
    """Whether this runs in a kernel that shows HTML."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return shell is not None and type(shell).__name__ not in ("TerminalInteractiveShell", "NoneType")
