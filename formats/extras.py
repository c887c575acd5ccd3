"""Which extra of the installation brings a library that not everyone needs."""

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
    return f"this needs {library}, which is not installed: pip install 'decogs[{extra}]'"
