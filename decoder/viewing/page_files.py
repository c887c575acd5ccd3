"""The files of the player's page, and its index.html made to play one stream."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from pathlib import Path
from urllib.parse import quote_from_bytes, urlsplit

from decogs.formats.errors import UsageError

PAGE = Path(__file__).parent / "page"
INDEX = "index.html"
POSTER = "poster.jpg"
FENCE = "fence.json"

MEDIA_TYPES = {
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".jpg": "image/jpeg",
    ".js": "text/javascript; charset=utf-8",
    ".txt": "text/plain; charset=utf-8",
    ".wasm": "application/wasm",
}
OTHER_MEDIA = "application/octet-stream"

POLICY = "; ".join(
    [
        "default-src 'none'",
        "script-src 'self' 'wasm-unsafe-eval'",
        "style-src 'self'",
        "connect-src 'self'",
        "img-src 'self' data:",
        "worker-src 'self'",
        "base-uri 'none'",
        "form-action 'none'",
        "require-trusted-types-for 'script'",
        "trusted-types decogs-page decogs-player decogs-controls decogs-crop",
    ]
)
"""What the page may do, for its server to say (Content-Security-Policy): nothing beyond what it brings itself.

Texts of a stream are a stranger's. The player shows them as text; if it ever failed to, no script would run.
"""

_HEAD = "<title>decogs</title>"
_PLACE = 'data-src="scene.dgs"'
"""In the built index.html, where the stream's address goes."""


@dataclass(frozen=True)
class PageFile:
    """A file of the page: its name, which is its address, too, and what it holds."""

    name: str
    data: bytes

    @property
    def media_type(self) -> str:
        """What a server tells browsers that it is; they run neither a script nor WebAssembly of another type."""
        return MEDIA_TYPES.get(Path(self.name).suffix, OTHER_MEDIA)


def page_files(
    stream: str,
    *,
    follow: bool = False,
    recordings: str | None = None,
    title: str = "",
    poster: bytes | None = None,
    subject: bool = False,
    url: str | None = None,
    fence: bytes | None = None,
) -> list[PageFile]:
    """The page that plays the stream of this file name beside it; index.html is last.

    ``follow``: a stream that still grows. ``recordings``: where the pictures of its rig lie, a template.
    ``title``: what it calls itself. ``poster``: a JPEG that is shown until somebody plays, and, with title or file
    name, in links to the page; of a ``subject`` only in these, since it would hide what a page has behind it. ``url``:
    where the page's folder will be, since others find the picture of a link only by its whole address. ``fence``: the
    map, JSON, of where views stay.
    Raises UsageError where the page was not built, or has a file of that name, and for a ``url`` that is none.
    """
    folder = "./" if url is None else _folder_address(url)
    try:
        files = {path.name: path.read_bytes() for path in sorted(PAGE.iterdir())}
        index = files.pop(INDEX).decode("utf-8")
    except (OSError, KeyError):
        raise UsageError(f"{PAGE}: the built player is missing; install decogs anew, or run make player") from None
    if poster is not None:
        files[POSTER] = poster
    if fence is not None:
        files[FENCE] = fence
    if stream in (*files, INDEX):
        raise UsageError(f"{stream}: the player's page has a file of that name; rename the stream")
    source = f'data-src="{escape(address_of(stream))}"' + (" follow" if follow else "")
    source += "" if fence is None else f' fence="./{FENCE}"'
    source += "" if recordings is None else f' recordings="{escape(recordings)}"'
    if poster is not None:
        source += "" if subject else f' poster="./{POSTER}"'
        link = {"title": title or stream.encode("utf-8", "replace").decode(), "type": "video.other"}
        link |= {"image": folder + POSTER} if url is None else {"image": folder + POSTER, "url": folder}
        tags = "".join(f'\n<meta property="og:{name}" content="{escape(text)}">' for name, text in link.items())
        index = index.replace(_HEAD, _HEAD + tags)
    index = index.replace(_PLACE, source)
    return [*(PageFile(name, data) for name, data in files.items()), PageFile(INDEX, index.encode("utf-8"))]


def _folder_address(url: str) -> str:
    """The address of a folder on a web server, which ends with a slash."""
    try:
        parts = urlsplit(url)
        has_host = parts.hostname and parts.port != 0 and parts.username is None  # a password is for nobody to read
        whole = parts.scheme in ("http", "https") and has_host and not (parts.query or parts.fragment)
    except ValueError:
        whole = False
    if not whole or not url.isprintable() or " " in url:
        raise UsageError(f"`url` {url}: is no address of a folder, such as https://example.org/show/")
    return url.removesuffix(INDEX).rstrip("/") + "/"


def address_of(name: str) -> str:
    """A file's name as an address beside the page; "./" keeps a colon in it from naming a scheme."""
    return "./" + quote_from_bytes(name.encode("utf-8", "surrogateescape"), safe="")
