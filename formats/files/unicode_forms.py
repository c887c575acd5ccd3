"""Names of files in either form of Unicode: é may be one sign, or an e and its accent, as on macOS."""

from __future__ import annotations

import os
import unicodedata
from pathlib import Path


def composed(name: str) -> str:
    """The name with one sign for a letter and its accents (NFC), in which names are compared."""
    return unicodedata.normalize("NFC", name)


def as_it_lies(path: Path) -> Path:
    """The path, or the one that lies there under the same name in another form."""
    if str(path).isascii() or os.path.lexists(path):
        return path
    folder = as_it_lies(path.parent)
    forms = (folder / unicodedata.normalize(form, path.name) for form in ("NFC", "NFD"))
    return next(filter(os.path.lexists, forms), folder / path.name)
