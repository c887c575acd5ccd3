"""decogs-view: what its server answers, the folder it writes, and what each refuses."""

from __future__ import annotations

import errno
import gzip
import http.client
import io
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest

from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.packets.syntax import write_key
from decogs.codec.scene.lattice import quantise
from decogs.decoder import open_stream, view
from decogs.decoder.commands import view_main
from decogs.decoder.editing import Set, Transform, edit
from decogs.decoder.rendering.views import render_view
from decogs.decoder.viewing import notebook, page_files, piped
from decogs.decoder.viewing.byte_ranges import NoSuchBytes, asked_range
from decogs.decoder.viewing.recorded_pictures import RecordedPictures
from decogs.decoder.viewing.server import StreamServer, serve_stream
from decogs.decoder.viewing.site import write_site
from decogs.formats.errors import RigError, StreamError, UsageError
from decogs.formats.rigs import open_rig, read_frames
from decogs.formats.stream.container import PacketKind, StreamWriter

RIG = Path(__file__).parents[2] / "demo" / "workbench"
COMMAND = Path(sys.executable).parent / "decogs-view"


@pytest.fixture
def served(small_stream: Any) -> Iterator[StreamServer]:
    with serve_stream(small_stream.path) as server:
        yield server


class Answer:
    """A response, read to its end."""

    def __init__(self, response: http.client.HTTPResponse) -> None:
        self.status, self.headers, self.body = response.status, response.headers, response.read()


def ask(url: str, path: str = "", method: str = "GET", **headers: str) -> Answer:
    """``path`` as it stands in the request line; names of headers with _ for -."""
    place = urlsplit(url)
    connection = http.client.HTTPConnection(place.hostname or "", place.port, timeout=10)
    try:
        connection.putrequest(method, f"/{path}", skip_host="Host" in headers, skip_accept_encoding=True)
        for name, value in headers.items():
            connection.putheader(name.replace("_", "-"), value)
        connection.endheaders()
        return Answer(connection.getresponse())
    finally:
        connection.close()


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        (None, None),
        ("bytes=0-0", range(0, 1)),
        ("bytes=3-", range(3, 10)),
        ("bytes=3-5", range(3, 6)),
        ("bytes=3-99", range(3, 10)),
        ("bytes=-4", range(6, 10)),
        ("bytes=-99", range(0, 10)),
        ("Bytes=9-9", range(9, 10)),
        ("bytes=5-3", None),
        ("bytes=-", None),
        ("bytes=a-b", None),
        ("bytes=0-1,3-4", None),
        ("bytes=٣-", None),
        ("lines=0-1", None),
        ("bytes=" + "9" * 40 + "-", None),
    ],
)
def test_a_range_is_read_as_the_rfc_has_it(header: str | None, expected: range | None) -> None:
    assert asked_range(header, 10) == expected


@pytest.mark.parametrize(
    ("header", "size"), [("bytes=10-", 10), ("bytes=10-20", 10), ("bytes=-0", 10), ("bytes=0-", 0)]
)
def test_a_range_outside_is_refused(header: str, size: int) -> None:
    with pytest.raises(NoSuchBytes):
        asked_range(header, size)


def test_the_whole_stream_and_parts_of_it(served: StreamServer, small_stream: Any) -> None:
    data = small_stream.path.read_bytes()
    name = small_stream.path.name
    whole = ask(served.url, name)
    assert (whole.status, whole.body) == (200, data)
    assert whole.headers["Content-Type"] == "application/octet-stream"
    assert whole.headers["Accept-Ranges"] == "bytes"
    part = ask(served.url, name, Range="bytes=10-29")
    assert (part.status, part.body) == (206, data[10:30])
    assert part.headers["Content-Range"] == f"bytes 10-29/{len(data)}"
    assert part.headers["Content-Length"] == "20"
    tail = ask(served.url, name, Range="bytes=-5")
    assert (tail.status, tail.body) == (206, data[-5:])
    outside = ask(served.url, name, Range=f"bytes={len(data)}-")
    assert (outside.status, outside.headers["Content-Range"]) == (416, f"bytes */{len(data)}")


def test_head_tells_the_same_without_the_bytes(served: StreamServer, small_stream: Any) -> None:
    name = small_stream.path.name
    for asked in ({}, {"Range": "bytes=1-3"}, {"Range": "bytes=999999999-"}):
        get, head = ask(served.url, name, **asked), ask(served.url, name, "HEAD", **asked)
        assert (head.status, head.body) == (get.status, b"")
        kept = ("Content-Length", "Content-Range", "ETag", "Content-Type")
        assert [head.headers[key] for key in kept] == [get.headers[key] for key in kept]
    assert ask(served.url, name, "POST").status == 501


def test_a_part_of_what_the_file_was_before_is_not_given(served: StreamServer, small_stream: Any) -> None:
    path = small_stream.path
    before = ask(served.url, path.name)
    tag, modified = before.headers["ETag"], before.headers["Last-Modified"]
    for known in (tag, modified):
        assert ask(served.url, path.name, Range="bytes=1-3", If_Range=known).status == 206
    assert ask(served.url, path.name, If_None_Match=tag).status == 304
    path.write_bytes(path.read_bytes() + b"more")
    os.utime(path, (1, 1))
    for known in (tag, modified):
        changed = ask(served.url, path.name, Range="bytes=1-3", If_Range=known)
        assert (changed.status, len(changed.body)) == (200, path.stat().st_size)
    assert ask(served.url, path.name, If_None_Match=tag).status == 200
    path.unlink()
    assert ask(served.url, path.name).status == 404


def test_the_page_and_its_types(served: StreamServer, small_stream: Any) -> None:
    index = ask(served.url)
    assert index.headers["Content-Type"].startswith("text/html")
    assert f'data-src="./{small_stream.path.name}"'.encode() in index.body
    assert b" follow" not in index.body.partition(b"<decogs-player")[2].partition(b">")[0]
    policy = index.headers["Content-Security-Policy"]
    assert f"\n{policy}\n" in (Path(__file__).parents[3] / "docs" / "see-it.md").read_text("utf-8")
    assert "unsafe-inline" not in policy
    assert ask(served.url, "index.html").body == index.body
    for path in page_files.PAGE.iterdir():
        if path.name != "index.html":
            assert ask(served.url, path.name).body == path.read_bytes()
    assert ask(served.url, "decogs-player.js").headers["Content-Type"].startswith("text/javascript")
    assert ask(served.url, "decogs-exact.wasm").headers["Content-Type"] == "application/wasm"


def test_the_page_comes_compressed_to_who_takes_that_and_the_stream_never(
    served: StreamServer, small_stream: Any
) -> None:
    worker = ask(served.url, "decogs-worker.js", Accept_Encoding="gzip, br")
    assert worker.headers["Content-Encoding"] == "gzip"
    assert len(worker.body) == int(worker.headers["Content-Length"]) < 30_000
    assert gzip.decompress(worker.body) == (page_files.PAGE / "decogs-worker.js").read_bytes()
    stream = ask(served.url, small_stream.path.name, Accept_Encoding="gzip")
    assert stream.headers["Content-Encoding"] is None
    assert stream.body == small_stream.path.read_bytes()


@pytest.mark.parametrize(
    "path",
    ["../secret.txt", "%2e%2e/secret.txt", "secret.txt", "//etc/passwd", "/etc/passwd", "./", "%00", "page/index.html"],
)
def test_nothing_else_is_served(served: StreamServer, small_stream: Any, path: str) -> None:
    small_stream.path.with_name("secret.txt").write_text("secret")
    answer = ask(served.url, path)
    assert answer.status == 404
    assert b"secret" not in answer.body


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("127.0.0.1", 200),
        ("localhost:8888", 200),
        ("LOCALHOST:1", 200),
        ("evil.example", 421),
        ("127.0.0.1.evil.example", 421),
        ("localhost@evil.example:80", 421),
        ("", 421),
    ],
)
def test_a_foreign_name_is_refused(served: StreamServer, host: str, status: int) -> None:
    assert ask(served.url, Host=host).status == status


def test_two_names_or_none_are_refused(served: StreamServer) -> None:
    place = urlsplit(served.url)
    for lines in (b"", b"Host: localhost\r\nHost: evil.example\r\n"):
        with socket.create_connection((place.hostname, place.port), timeout=10) as connection:
            connection.sendall(b"GET / HTTP/1.1\r\n" + lines + b"Connection: close\r\n\r\n")
            assert connection.recv(100).startswith(b"HTTP/1.1 421")


@pytest.mark.parametrize("follow", [False, True])
@pytest.mark.parametrize("there", ["fifo", "folder"])
def test_what_took_the_stream_s_place_is_not_waited_for(small_stream: Any, follow: bool, there: str) -> None:
    with serve_stream(small_stream.path, follow=follow) as server:
        small_stream.path.unlink()
        os.mkfifo(small_stream.path) if there == "fifo" else small_stream.path.mkdir()
        assert ask(server.url, small_stream.path.name).status == 404


@pytest.mark.parametrize("place", ["/", "http://[/x", "http://[1:2/"])
@pytest.mark.parametrize("lengths", [["0", "10"], ["10", "0"], ["0"], ["0", "0"], []])
def test_requests_that_are_none_are_answered(served: StreamServer, place: str, lengths: list[str]) -> None:
    """An address that says nothing, and lengths that disagree; the body is never taken for another request."""
    head = f"GET {place} HTTP/1.1\r\nHost: localhost\r\n" + "".join(f"Content-Length: {n}\r\n" for n in lengths)
    body = b"GET /x HTTP/1.1\r\nHost: localhost\r\n\r\n" if "10" in lengths else b""
    host = urlsplit(served.url)
    with socket.create_connection((host.hostname, host.port), timeout=10) as connection:
        connection.sendall(head.encode() + b"\r\n" + body)
        connection.shutdown(socket.SHUT_WR)
        answer = b"".join(iter(lambda: connection.recv(1 << 16), b""))
    good = place == "/" and "10" not in lengths
    assert answer.startswith(b"HTTP/1.1 200 " if good else b"HTTP/1.1 400 ")
    assert answer.count(b"HTTP/1.1 ") == 1


@pytest.mark.parametrize(("headers", "answers"), [("", 2), ("Transfer-Encoding: chunked\r\n", 1)])
def test_a_connection_stays_open_but_after_a_body(served: StreamServer, headers: str, answers: int) -> None:
    """A body of no stated length is never taken for another request; without one, the next request is answered."""
    requests = [f"HEAD / HTTP/1.1\r\nHost: localhost\r\n{more}\r\n" for more in (headers, "Connection: close\r\n")]
    host = urlsplit(served.url)
    with socket.create_connection((host.hostname, host.port), timeout=10) as connection:
        connection.sendall("".join(requests).encode())
        connection.shutdown(socket.SHUT_WR)
        assert b"".join(iter(lambda: connection.recv(1 << 16), b"")).count(b"HTTP/1.1 200 ") == answers


def test_a_connection_stays_open_after_the_stream(served: StreamServer, small_stream: Any) -> None:
    host = urlsplit(served.url)
    connection = http.client.HTTPConnection(host.hostname or "", host.port, timeout=10)
    for _ in range(2):
        connection.request("GET", f"/{small_stream.path.name}")
        assert Answer(connection.getresponse()).body == small_stream.path.read_bytes()
    connection.close()


def test_only_this_machine_is_listened_to(served: StreamServer) -> None:
    assert served.url.startswith("http://127.0.0.1:")
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.2", urlsplit(served.url).port or 0), timeout=5)


def test_a_growing_stream_is_served_as_far_as_it_is(small_stream: Any) -> None:
    path = small_stream.path
    data, growing = path.read_bytes(), path.with_name(path.name + ".part")
    path.unlink()
    growing.write_bytes(data[:600])
    with serve_stream(growing, follow=True) as server:
        assert b" follow" in ask(server.url).body.partition(b"<decogs-player")[2].partition(b">")[0]
        first = ask(server.url, path.name, Range="bytes=0-999")
        assert (first.status, first.body) == (206, data[:600])
        assert first.headers["Content-Range"] == "bytes 0-599/600"
        assert first.headers["Cache-Control"] == "no-store"
        assert first.headers["ETag"] is None
        assert ask(server.url, path.name, Range="bytes=600-").status == 416
        growing.write_bytes(data)
        assert ask(server.url, path.name, Range="bytes=600-").body == data[600:]
        growing.rename(path)
        assert ask(server.url, path.name).body == data


@pytest.mark.parametrize("kind", ["pipe", "memory"])
def test_a_stream_through_a_pipe_is_served_as_far_as_it_came(small_stream: Any, kind: str) -> None:
    data = small_stream.path.read_bytes()
    if kind == "memory":
        with view(io.BytesIO(data), browser=False) as shown:
            assert eventually(shown.url, data)
        return
    reading, writing = os.pipe()
    with os.fdopen(reading, "rb") as pipe, os.fdopen(writing, "wb", buffering=0) as encoder:
        encoder.write(data[: len(data) // 2])
        with view(pipe, browser=False) as shown:
            assert b" follow" in ask(shown.url).body
            assert eventually(shown.url, data[: len(data) // 2])
            encoder.write(data[len(data) // 2 :])
            assert eventually(shown.url, data)
            encoder.close()
            assert eventually(shown.url, data)
            kept = Path(shown._piped.path)  # type: ignore[union-attr]
            assert kept.parent.exists()
    assert not kept.parent.exists()


def eventually(url: str, served: bytes) -> bool:
    """Whether the stream that is served has these bytes within ten seconds."""
    end = time.monotonic() + 10
    while (found := ask(url, "stream.dgs")).body != served and time.monotonic() < end:
        time.sleep(0.01)
    return found.body == served


def test_a_pipe_without_a_stream_is_refused(capsys: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for data in b"", b"no stream at all, but text":
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))
        assert view_main(["-", "--no-browser"]) == 2
        assert capsys.readouterr().err.startswith("decogs-view: error: -: ")
    assert view_main(["-", "-o", str(tmp_path / "site")]) == 2
    assert "-: a pipe cannot be seeked" in capsys.readouterr().err


def test_a_disk_that_is_full_ends_what_is_served(small_stream: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing would take the pipe's bytes any more, and the encoder would wait for ever."""

    def full(*names: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(piped.os, "replace", full)
    with (
        view(io.BytesIO(small_stream.path.read_bytes()), browser=False) as shown,
        pytest.raises(OSError, match="space"),
    ):
        shown.wait()


@pytest.mark.parametrize("name", ["a b&<'\".dgs", "häuser #1?.dgs", "http:x.dgs", "100%.dgs"])
def test_odd_names_reach_the_page_and_the_server(small_stream: Any, tmp_path: Path, name: str) -> None:
    path = small_stream.path.rename(small_stream.path.with_name(name))
    with serve_stream(path) as server:
        from html import unescape

        address = unescape(ask(server.url).body.decode().partition('data-src="')[2].partition('"')[0])
        assert address.startswith("./")
        assert ask(server.url, address.removeprefix("./")).body == path.read_bytes()


def test_a_stream_of_a_page_files_name_is_refused(small_stream: Any) -> None:
    path = small_stream.path.rename(small_stream.path.with_name("decogs-player.js"))
    with pytest.raises(UsageError, match="rename the stream"):
        serve_stream(path)


def test_a_port_that_is_taken_is_said(served: StreamServer, small_stream: Any, capsys: Any) -> None:
    port = str(urlsplit(served.url).port)
    assert view_main([str(small_stream.path), "--no-browser", "--port", port]) == 2
    assert f"--port {port}: Address already in use" in capsys.readouterr().err
    assert view_main([str(small_stream.path), "--no-browser", "--port", "99999"]) == 2


def test_a_damaged_header_is_refused_before_anything_is_served(
    small_stream: Any, tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: object, **__: object) -> None:
        raise AssertionError("served")

    monkeypatch.setattr("decogs.decoder.viewing.server.serve_stream", never)
    data = bytearray(small_stream.path.read_bytes())
    data[60] ^= 255
    (tmp_path / "bad.dgs").write_bytes(data)
    (tmp_path / "text.dgs").write_text("no stream")
    for name in ("bad.dgs", "text.dgs", "missing.dgs"):
        for more in ([], ["-o", str(tmp_path / "site")], ["--follow", "--idle", "0.1"]):
            assert view_main([str(tmp_path / name), "--no-browser", *more]) == 2
            said = capsys.readouterr().err
            assert said.count("\n") == 1
            assert name in said
    assert not (tmp_path / "site").exists()
    with pytest.raises(StreamError):
        view(tmp_path / "bad.dgs", browser=False)


def test_the_command_prints_the_address_and_ends_quietly(small_stream: Any) -> None:
    stream = small_stream.path.rename(small_stream.path.with_name("a\nb.dgs"))
    command = [str(COMMAND), str(stream), "--no-browser"]
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A shell ignores SIGINT for what it starts in the background, and its children inherit that.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            url = next(word for word in line.split() if word.startswith("http"))
            assert ask(url, "a%0Ab.dgs").body == stream.read_bytes()
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=60)
        finally:
            process.kill()
    assert (process.returncode, out, err) == (0, "", "")


def test_a_browser_is_opened_only_where_asked_for(small_stream: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr(notebook, "open_browser", opened.append)
    for variable in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(variable, raising=False)
    with view(small_stream.path):
        assert opened == []
    monkeypatch.setenv("DISPLAY", ":0")
    with view(small_stream.path) as shown:
        assert opened == [shown.url]
    with view(small_stream.path, browser=False):
        assert len(opened) == 1


def test_a_notebook_shows_the_page_inline(small_stream: Any) -> None:
    with view(small_stream.path, browser=False, width="50%", height=300) as shown:
        html = shown._repr_html_()
        assert f'src="{shown.url}"' in html
        assert 'width="50%" height="300"' in html
        url = shown.url
        assert ask(url).status == 200
    with pytest.raises(OSError, match="refused"):
        ask(url)
    shown.close()


def test_a_fence_lies_beside_the_page(small_stream: Any, tmp_path: Path, capsys: Any) -> None:
    site, fence = tmp_path / "site", tmp_path / "map.json"
    fence.write_text('{"within": [[true]]}')
    arguments = [str(small_stream.path), "--fence", str(fence)]
    assert view_main([*arguments, "-o", str(site)]) == 0
    assert (site / "fence.json").read_bytes() == fence.read_bytes()
    assert ' fence="./fence.json"' in (site / "index.html").read_text()
    assert view_main([str(small_stream.path), "-o", str(site), "--overwrite"]) == 0
    assert "fence" not in (site / "index.html").read_text()
    assert view_main(arguments) == 2
    assert "--fence goes into a folder" in capsys.readouterr().err
    for other in "{}", "[", "7":
        fence.write_text(other)
        assert view_main([*arguments, "-o", str(tmp_path / "new")]) == 2
        assert "is no map of where a scene holds" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_a_site_holds_the_page_and_the_stream(small_stream: Any, tmp_path: Path, capsys: Any) -> None:
    site = tmp_path / "deep" / "site"
    assert view_main([str(small_stream.path), "-o", str(site)]) == 0
    names = {path.name for path in page_files.PAGE.iterdir()} | {small_stream.path.name, "poster.jpg"}
    assert {path.name for path in site.iterdir()} == names
    assert 'poster="./poster.jpg"' in (site / "index.html").read_text()
    assert '<meta property="og:image" content="./poster.jpg">' in (site / "index.html").read_text()
    told = capsys.readouterr().out
    assert f"{len(names)} files" in told
    assert f"python3 -m http.server -d {site}" in told
    assert (site / small_stream.path.name).read_bytes() == small_stream.path.read_bytes()
    assert f'data-src="./{small_stream.path.name}"' in (site / "index.html").read_text()
    assert site.stat().st_mode & 0o055 == 0o055
    (site / "index.html").write_text("<decogs-player>outdated")
    assert view_main([str(small_stream.path), "-o", str(site)]) == 0
    assert "outdated" not in (site / "index.html").read_text()


def test_the_poster_is_the_first_frame_of_the_first_camera(small_stream: Any, tmp_path: Path) -> None:
    site = tmp_path / "site"
    assert view_main([str(small_stream.path), "-o", str(site)]) == 0
    with open_stream(small_stream.path) as stream:
        name = next(camera.name for camera in stream.header.cameras if camera.name not in stream.header.held_out)
        frame = next(stream.frames(0, 1))
        expected = render_view(stream.header, frame.splats, name, undistorted=True).image
    found = cv2.imread(str(site / "poster.jpg"))[..., ::-1].astype(float) / 255
    assert found.shape == expected.shape
    assert np.abs(found - np.clip(expected, 0, 1)).mean() < 0.03  # JPEG at the quality of recordings


def test_the_stream_says_which_frame_camera_and_title_links_show(small_stream: Any, tmp_path: Path) -> None:
    shown, site = tmp_path / "shown.dgs", tmp_path / "site"
    with open_stream(small_stream.path) as stream:
        poster, view = stream.frame_count - 1, stream.header.cameras[-1].name
    change = Set(title='A "b" & <c>', poster=poster, first_view=view)
    edit(small_stream.path, shown, [change, Transform(scale=2.0, shift=(1.0, 2.0, 3.0))])
    assert view_main([str(shown), "-o", str(site)]) == 0
    with open_stream(shown) as stream:
        frame = next(stream.frames(poster, poster + 1))
        expected = render_view(stream.header, frame.splats, view, undistorted=True).image
    found = cv2.imread(str(site / "poster.jpg"))[..., ::-1].astype(float) / 255
    assert np.abs(found - np.clip(expected, 0, 1)).mean() < 0.03
    title = '<meta property="og:title" content="A &quot;b&quot; &amp; &lt;c&gt;">'
    assert title in (site / "index.html").read_text()


def _links(site: Path) -> dict[str, str]:
    """What links to a page say of it."""
    return dict(re.findall(r'<meta property="og:(\w+)" content="([^"]*)">', (site / "index.html").read_text("utf-8")))


@pytest.mark.parametrize(
    ("url", "folder"),
    [
        ("https://example.org/show/", "https://example.org/show/"),
        ("https://example.org/show", "https://example.org/show/"),
        ("http://localhost:8000", "http://localhost:8000/"),
        ("https://example.org/a/index.html", "https://example.org/a/"),
        ("https://example.org/a&b/", "https://example.org/a&amp;b/"),
    ],
)
def test_links_have_the_whole_address_of_their_picture_where_it_is_known(
    small_stream: Any, tmp_path: Path, url: str, folder: str
) -> None:
    assert view_main([str(small_stream.path), "-o", str(tmp_path / "site"), "--url", url]) == 0
    links = _links(tmp_path / "site")
    assert (links["image"], links["url"]) == (f"{folder}poster.jpg", folder)
    assert 'poster="./poster.jpg"' in (tmp_path / "site" / "index.html").read_text("utf-8")


@pytest.mark.parametrize(
    "url",
    [
        "example.org/show",
        "/show/",
        "ftp://example.org/",
        "https://",
        "https://a.org/?x",
        "https://a.org/#x",
        "https://a b/",
        "https://[::1/",
        "https://a.org:99999/",
        "https://me:secret@a.org/",
        "https://a.org/\u202e",
        "",
    ],
)
def test_what_is_no_address_of_a_folder_is_refused(small_stream: Any, tmp_path: Path, url: str, capsys: Any) -> None:
    assert view_main([str(small_stream.path), "-o", str(tmp_path / "site"), "--url", url]) == 2
    assert "is no address of a folder" in capsys.readouterr().err
    assert not (tmp_path / "site").exists()


def test_an_address_without_a_folder_is_refused(small_stream: Any, capsys: Any) -> None:
    assert view_main([str(small_stream.path), "--url", "https://example.org/"]) == 2
    assert "write one with -o" in capsys.readouterr().err


def test_links_to_a_subject_show_it_over_black_and_the_page_shows_through(small_stream: Any, tmp_path: Path) -> None:
    subject = tmp_path / "subject.dgs"
    with open_stream(small_stream.path) as stream, subject.open("wb") as file:
        header = replace(stream.header, subject=True, background=(0.2, 0.3, 0.5))
        writer = StreamWriter(file, header.to_bytes())
        frame = next(stream.frames(0, 1))
        writer.write(PacketKind.KEY, 0, write_key(keyframe_state(quantise(frame.splats, header.lattice))[0]).payload)
        writer.finish()
    assert view_main([str(subject), "-o", str(tmp_path / "site"), "--url", "https://example.org/"]) == 0
    links = _links(tmp_path / "site")
    assert (links["image"], links["title"]) == ("https://example.org/poster.jpg", "subject.dgs")
    assert "poster=" not in (tmp_path / "site" / "index.html").read_text("utf-8")
    with open_stream(subject) as stream:
        name = next(camera.name for camera in stream.header.cameras if camera.name not in stream.header.held_out)
        splats = next(stream.frames(0, 1)).splats
        expected = render_view(stream.header, splats, name, background=(0, 0, 0), undistorted=True).image
    found = cv2.imread(str(tmp_path / "site" / "poster.jpg"))[..., ::-1].astype(float) / 255
    assert np.abs(found - np.clip(expected, 0, 1)).mean() < 0.03


def test_a_folder_of_someone_elses_is_left_alone(small_stream: Any, tmp_path: Path, capsys: Any) -> None:
    site, stream = tmp_path / "site", str(small_stream.path)
    site.mkdir()
    (site / "index.html").write_text("mine")
    assert view_main([stream, "-o", str(site)]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert [path.name for path in site.iterdir()] == ["index.html"]
    (site / "style.css").write_text("mine")
    assert view_main([stream, "-o", str(site), "--overwrite"]) == 0
    assert (site / "style.css").read_text() == "mine"
    assert "<decogs-player" in (site / "index.html").read_text()
    assert view_main([stream, "-o", str(site)]) == 2
    assert view_main([stream, "-o", stream]) == 2
    assert view_main([str(site / small_stream.path.name), "-o", str(site), "--overwrite"]) == 2
    assert view_main([stream, "-o", str(tmp_path / "other"), "--follow"]) == 2
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize("way", ["written into", "replaced"])
def test_a_site_is_of_one_stream(small_stream: Any, tmp_path: Path, way: str) -> None:
    data = small_stream.path.read_bytes()

    def change(done: int, total: int) -> None:
        file = small_stream.path if way == "written into" else tmp_path / "new"
        file.write_bytes(data + b"more")
        os.replace(file, small_stream.path)

    with pytest.raises(UsageError, match=r"scene\.dgs: changed while it was read"):
        write_site(small_stream.path, tmp_path / "site", on_megabytes=change)
    assert not (tmp_path / "site").exists()


def test_a_site_that_cannot_be_written_is_not_begun(
    small_stream: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("decogs.decoder.viewing.site._copy", full)
    before = sorted(tmp_path.rglob("*"))
    assert view_main([str(small_stream.path), "-o", str(tmp_path / "site")]) == 2
    assert f"{tmp_path / 'site'}: No space left on device; make room" in capsys.readouterr().err
    assert sorted(tmp_path.rglob("*")) == before


def test_twenty_at_once_and_a_slow_one(served: StreamServer, small_stream: Any) -> None:
    """A connection that says nothing keeps nobody waiting."""
    place = urlsplit(served.url)
    with socket.create_connection((place.hostname, place.port)):
        since = time.monotonic()
        for _ in range(20):
            assert ask(served.url, small_stream.path.name).status == 200
        assert time.monotonic() - since < 5


def test_the_rig_s_pictures_are_those_of_the_stream_s_frames(small_stream: Any) -> None:
    """In any order: forward, back, another camera; frame 0 of the stream is the rig's ``first_frame``."""
    header = replace(small_stream.header, first_frame=1)
    recordings = RecordedPictures(RIG, header)
    expected = dict(read_frames(open_rig(RIG), names=["cam00", "cam01"]))
    with serve_stream(small_stream.path, recordings=recordings) as server:
        assert b'recordings="./recorded/{camera}/{frame}.jpg"' in ask(server.url).body
        for camera, frame in (("cam00", 0), ("cam00", 2), ("cam00", 1), ("cam01", 1), ("cam00", 1)):
            answer = ask(server.url, f"recorded/{camera}/{frame}.jpg")
            assert (answer.status, answer.headers["Content-Type"]) == (200, "image/jpeg")
            seen = cv2.imdecode(np.frombuffer(answer.body, np.uint8), cv2.IMREAD_COLOR)[..., ::-1].astype(float)
            recorded = expected[frame + 1][camera != "cam00"].astype(float)
            assert (
                np.abs(seen - recorded).mean() < 4
            )  # JPEG halves the colours' resolution, and the film's grain is fine
            other = expected[frame][camera != "cam00"].astype(float)
            assert np.abs(seen - recorded).mean() < np.abs(seen - other).mean()


@pytest.mark.parametrize(
    "path",
    [
        "recorded/cam00/99.jpg",
        "recorded/cam00/-1.jpg",
        "recorded/cam00/1",
        "recorded/cam00/%D9%A1.jpg",
        "recorded/cam00/9999999999.jpg",
        "recorded/cam77/1.jpg",
        "recorded/../rig.json",
        "recorded/cam00/../cam00/1.jpg",
        "recorded/",
        "cam00/1.jpg",
    ],
)
def test_nothing_else_of_a_rig_is_served(small_stream: Any, path: str) -> None:
    with serve_stream(small_stream.path, recordings=RecordedPictures(RIG, small_stream.header)) as server:
        assert ask(server.url, path).status == 404


def test_a_rig_that_does_not_fit_is_refused(small_stream: Any, tmp_path: Path, capsys: Any) -> None:
    with pytest.raises(RigError, match="no calibration"):
        RecordedPictures(tmp_path, small_stream.header)
    with pytest.raises(UsageError, match="ends before the stream's first frame"):
        RecordedPictures(RIG, replace(small_stream.header, first_frame=1000))
    other = tuple(replace(camera, name=f"x{camera.name}") for camera in small_stream.header.cameras)
    with pytest.raises(UsageError, match="has no camera of the stream"):
        RecordedPictures(RIG, replace(small_stream.header, cameras=other, held_out=()))
    assert view_main([str(small_stream.path), "-o", str(tmp_path / "site"), "--rig", str(RIG)]) == 2
    assert "leave out --rig" in capsys.readouterr().err
    assert not (tmp_path / "site").exists()
