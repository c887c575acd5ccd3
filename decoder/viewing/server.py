"""A server for one stream and the page that plays it, for this machine only.

The standard library's server, one thread a connection, which browsers keep open. It is bound to 127.0.0.1, knows a
fixed list of addresses (no path is ever looked up on the disk), answers ranges, and refuses requests that a web site
had its visitors' browsers send under a name of its own (DNS rebinding).

A stream that grows is opened anew for each request, under the name that it has by then.
"""

from __future__ import annotations

import gzip
import os
import re
import threading
from collections.abc import Callable
from contextlib import suppress
from email.utils import formatdate
from functools import cache
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from socket import socket
from typing import Any, BinaryIO
from urllib.parse import unquote, urlsplit

from decogs.formats.errors import RigError, UsageError
from decogs.formats.files.outputs import is_device, part_of
from decogs.formats.files.regular_files import open_regular

from ..reading.following import followed, open_growing
from .byte_ranges import NoSuchBytes, asked_range
from .page_files import INDEX, OTHER_MEDIA, POLICY, PageFile, page_files
from .recorded_pictures import RecordedPictures

HOST = "127.0.0.1"
_OWN_NAME = re.compile(r"(127\.0\.0\.1|localhost)(:[0-9]+)?", re.ASCII | re.IGNORECASE)
_SILENT_SECONDS = 120
"""A connection without a request is closed after so long."""
_CHUNK = 1 << 18

Opener = Callable[[], BinaryIO]


class StreamServer:
    """Serves a stream at ``url`` until ``close``; a context manager. Build one with ``serve_stream``."""

    def __init__(self, server: _Server) -> None:
        self._server = server
        self.url = f"http://{HOST}:{server.server_address[1]}/"
        self._thread = threading.Thread(target=server.serve_forever, args=(0.05,), name="decogs-view", daemon=True)
        self._thread.start()

    def __enter__(self) -> StreamServer:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def wait(self) -> None:
        """Returns when someone closes it."""
        while self._thread.is_alive():
            self._thread.join(1.0)  # a join without an end would keep Ctrl-C waiting on some systems

    def close(self) -> None:
        """Ends it; what a browser has loaded stays there. Closing twice does no harm."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def serve_stream(
    stream: str | os.PathLike[str],
    *,
    port: int = 0,
    follow: bool = False,
    recordings: RecordedPictures | None = None,
) -> StreamServer:
    """Starts to serve the file and the page that plays it, on 127.0.0.1; ``port`` 0 takes one that is free.

    ``follow``: the stream is still being written, as ``NAME.part`` until it is whole; ``stream`` is either name.
    ``recordings``: its rig's pictures, which are served, too. Nothing of the stream is looked at.
    Raises UsageError for a port that is not to be had.
    """
    path = followed(stream) if follow else Path(stream)
    page = page_files(path.name, follow=follow, recordings=None if recordings is None else recordings.address)
    return StreamServer(_listening(page, path, port, follow, recordings))


def _listening(
    page: list[PageFile], path: Path, port: int, growing: bool, recordings: RecordedPictures | None
) -> _Server:
    def opened() -> BinaryIO:
        if not growing:
            return open_regular(path)
        if is_device(path) or is_device(part_of(path)):
            raise FileNotFoundError(path)  # It was put in the stream's place, and would be waited for.
        with suppress(FileNotFoundError):
            return open_growing(path)
        return open_growing(path)  # it was renamed between two looks

    try:
        return _Server(page, path.name, opened, port, growing, recordings)
    except OverflowError:
        raise UsageError(f"`port` {port} is none; choose one from 1024 to 65535, or 0 for any that is free") from None
    except OSError as error:
        raise UsageError(f"`port` {port}: {error.strerror}; choose another one, or 0 for any that is free") from None


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def __init__(
        self,
        page: list[PageFile],
        stream_name: str,
        opened: Opener,
        port: int,
        growing: bool,
        recordings: RecordedPictures | None,
    ) -> None:
        self.recordings = recordings
        self.page = {file.name: file for file in page} | {"": page[-1]}
        self.stream_name, self.opened, self.growing = stream_name, opened, growing
        super().__init__((HOST, port), _Handler)

    def server_bind(self) -> None:
        """Without the look-up of this machine's name that the library does, which can take seconds."""
        self.socket.bind(self.server_address)
        self.server_address = self.socket.getsockname()
        self.server_name, self.server_port = HOST, self.server_address[1]

    def handle_error(self, request: socket | tuple[bytes, socket], client_address: Any) -> None:
        """A browser that goes away in the middle of an answer is no error."""


@cache
def _compressed(data: bytes) -> bytes:
    return gzip.compress(data, mtime=0)


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "decogs", ""
    timeout = _SILENT_SECONDS
    disable_nagle_algorithm = True

    def log_message(self, format: str, *args: Any) -> None:
        """Says nothing: the terminal is the user's."""

    def do_GET(self) -> None:
        self._answer()

    def do_HEAD(self) -> None:
        self._answer()

    def _answer(self) -> None:
        lengths = set(self.headers.get_all("Content-Length", ["0"]))
        if lengths != {"0"} or "Transfer-Encoding" in self.headers:
            self.close_connection = True  # a body, which nobody reads, would pass for the next request
        if len(lengths) > 1:
            self._refuse(HTTPStatus.BAD_REQUEST, "this request has several lengths")
            return
        if not self._is_for_this_machine():
            self._refuse(HTTPStatus.MISDIRECTED_REQUEST, "this address is for the machine that serves it only")
            return
        try:
            name = unquote(urlsplit(self.path).path, errors="surrogateescape").removeprefix("/")
        except ValueError:
            self._refuse(HTTPStatus.BAD_REQUEST, "this is no address")
            return
        if name == self.server.stream_name:
            self._send_stream()
        elif name in self.server.page:
            self._send_page(self.server.page[name])
        elif not self._send_recording(name):
            self._refuse(HTTPStatus.NOT_FOUND, "there is nothing here")

    def _send_recording(self, name: str) -> bool:
        """Sends a picture of the rig; False where this is none."""
        recordings = self.server.recordings
        try:
            data = None if recordings is None else recordings.file_at(name)
        except RigError as error:
            self._refuse(HTTPStatus.NOT_FOUND, str(error))
            return True
        if data is None:
            return False
        self.send_response(HTTPStatus.OK)
        self._common("image/jpeg", len(data))
        self.send_header("Cache-Control", "no-cache")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(data)
        return True

    def _is_for_this_machine(self) -> bool:
        """A forwarded port may be another one, but a name that is not this machine's is a web site's."""
        hosts = self.headers.get_all("Host") or []
        return len(hosts) == 1 and _OWN_NAME.fullmatch(hosts[0]) is not None

    def _send_page(self, file: PageFile) -> None:
        # The way may be a narrow one: a forwarded port.
        packed = "gzip" in self.headers.get("Accept-Encoding", "")
        data = _compressed(file.data) if packed else file.data
        self.send_response(HTTPStatus.OK)
        self._common(file.media_type, len(data))
        self.send_header("Cache-Control", "no-cache")
        self.send_header("Vary", "Accept-Encoding")
        if packed:
            self.send_header("Content-Encoding", "gzip")
        if file.name == INDEX:
            self.send_header("Content-Security-Policy", POLICY)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(data)

    def _send_stream(self) -> None:
        try:
            file = self.server.opened()
        except OSError:
            self._refuse(HTTPStatus.NOT_FOUND, "the stream's file is not there any more")
            return
        with file:
            # What comes while it is sent is for the next request: the answer says how long it is before it begins.
            status = os.fstat(file.fileno())
            tag = f'"{status.st_ino:x}-{status.st_mtime_ns:x}-{status.st_size:x}"'
            modified = formatdate(status.st_mtime, usegmt=True)
            if not self.server.growing and self.headers.get("If-None-Match") == tag:
                self.send_response(HTTPStatus.NOT_MODIFIED)
                self._validators(tag, modified)
                self.end_headers()
                return
            try:
                chosen = asked_range(self._range_unless_changed(tag, modified), status.st_size)
            except NoSuchBytes:
                self._refuse(
                    HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE,
                    "the stream has no such bytes",
                    ("Content-Range", f"bytes */{status.st_size}"),
                )
                return
            sent = range(status.st_size) if chosen is None else chosen
            self.send_response(HTTPStatus.OK if chosen is None else HTTPStatus.PARTIAL_CONTENT)
            self._common(OTHER_MEDIA, len(sent))
            self.send_header("Accept-Ranges", "bytes")
            self._validators(tag, modified)
            if chosen is not None:
                self.send_header("Content-Range", f"bytes {sent.start}-{sent.stop - 1}/{status.st_size}")
            self.end_headers()
            if self.command != "HEAD":
                self._send_bytes(file, sent)

    def _range_unless_changed(self, tag: str, modified: str) -> str | None:
        """The Range header; None when the bytes that the browser has are of another state of the file."""
        if self.headers.get("If-Range", tag) in (tag, modified):
            return self.headers.get("Range")
        return None

    def _validators(self, tag: str, modified: str) -> None:
        if self.server.growing:
            self.send_header("Cache-Control", "no-store")
        else:
            self.send_header("Cache-Control", "no-cache")
            self.send_header("ETag", tag)
            self.send_header("Last-Modified", modified)

    def _send_bytes(self, file: BinaryIO, sent: range) -> None:
        file.seek(sent.start)
        left = len(sent)
        while left and (data := file.read(min(left, _CHUNK))):
            self.wfile.write(data)
            left -= len(data)
        if left:
            self.close_connection = True  # the file was cut meanwhile: the browser sees that the answer is not whole

    def _common(self, media_type: str, length: int) -> None:
        self.send_header("Content-Type", media_type)
        self.send_header("Content-Length", str(length))
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.send_header("Referrer-Policy", "no-referrer")

    def _refuse(self, status: HTTPStatus, reason: str, *headers: tuple[str, str]) -> None:
        text = f"{reason}\n".encode()
        self.send_response(status)
        self._common("text/plain; charset=utf-8", len(text))
        self.send_header("Cache-Control", "no-store")
        for name, value in headers:
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(text)
