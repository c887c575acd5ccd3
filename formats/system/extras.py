"""Which extra of the installation brings a library that not everyone needs, and how it is installed."""

from __future__ import annotations

_BROUGHT = {"cv2": ("OpenCV", "encode"), "av": ("PyAV", "video"), "pxr": ("OpenUSD", "usd")}
"""By module: the library, and the smallest extra that has it."""


def what_to_install(error: ModuleNotFoundError, *, whole: str | None = None) -> str | None:
    """A sentence about the library that could not be imported; None where it is none of an extra's.

    ``whole``: the extra that has all that a command needs, where that is more than one library.
    """
    package = (error.name or "").partition(".")[0]
    if package not in _BROUGHT:
        return None
    library, extra = _BROUGHT[package]
    extra = whole if whole and extra != "usd" else extra
    return f"this needs {library}, which is not installed: {install(extra)}"


def install(extra: str) -> str:
    """The command that brings an extra: from the checkout or wheel that decogs was installed from, or else by name."""
    # Commands import this module, and few of them ever need these.
    import json
    from importlib import metadata
    from pathlib import Path
    from urllib.parse import urlsplit
    from urllib.request import url2pathname

    try:
        origin = json.loads(metadata.distribution("decogs").read_text("direct_url.json") or "{}")  # PEP 610
    except metadata.PackageNotFoundError:
        origin = {}
    address = urlsplit(origin.get("url", ""))
    path = Path(url2pathname(address.path))
    if address.scheme != "file" or not path.exists():
        return f"pip install 'decogs[{extra}]'"
    editable = "-e " if origin.get("dir_info", {}).get("editable") else ""
    return f"pip install {editable}'{path}[{extra}]'"
