"""Packs the Blender extension: the add-on, its manifest, and a wheel with what reads a .dgs stream.

    python blender/build.py build/decogs-blender.zip

Needs the standard library only. The wheel holds the modules that the add-on imports and those that they import, and no
others: the reader is a tenth of decogs and needs numpy and zstandard, which Blender has. The same sources make the same
bytes.
"""

from __future__ import annotations

import ast
import base64
import hashlib
import io
import re
import sys
import zipfile
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LAYERS = ("formats", "codec", "decoder")
_EARLIEST = (1980, 1, 1, 0, 0, 0)


def version() -> str:
    """Of decogs. Without tomllib, which Python 3.10 has not."""
    found = re.search(r'^version = "([^"]+)"$', (ROOT / "pyproject.toml").read_text("utf-8"), re.MULTILINE)
    if found is None:
        raise SystemExit("pyproject.toml: has no line with a version")
    return found[1]


def bundled_modules() -> dict[str, Path]:
    """Modules of decogs by name that the add-on needs, directly or through others."""
    found: dict[str, Path] = {}
    waiting = {name for path in addon_modules() for name in _imports(path, "addon")}
    while waiting:
        name = waiting.pop()
        path = _path(name)
        if name in found or path is None:
            continue
        found[name] = path
        waiting |= _imports(path, name.rpartition(".")[0])
    return dict(sorted(found.items()))


def addon_modules() -> list[Path]:
    """The add-on's own files."""
    return sorted((ROOT / "blender" / "addon").glob("*.py"))


def _path(module: str) -> Path | None:
    """The file of a module; None for a layer itself, of which only modules are taken."""
    _, layer, *rest = module.split(".")
    if layer not in LAYERS:
        raise SystemExit(f"{module}: is imported by the Blender add-on, which may use {', '.join(LAYERS)} only")
    if not rest:
        return None
    path = ROOT.joinpath(layer, *rest).with_suffix(".py")
    if not path.is_file():
        raise SystemExit(
            f"{module}: is imported for the Blender add-on and is no module; import a module, not a folder"
        )
    return path


def _imports(path: Path, package: str) -> set[str]:
    """Modules of decogs that a file imports, anywhere in it but for type checkers."""
    found: set[str] = set()
    waiting: list[ast.AST] = [ast.parse(path.read_text("utf-8"))]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            waiting += node.orelse
            continue
        waiting += ast.iter_child_nodes(node)
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            parts = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*parts, *([node.module] if node.module else [])])
            names = [base] if base not in _layers() else [f"{base}.{alias.name}" for alias in node.names]
        found |= {name for name in names if name.startswith("decogs.")}
    return found


def _folders(modules: Iterable[str]) -> dict[str, bytes]:
    """An ``__init__.py`` for every folder: its own imports more than the reader, such as what Blender lacks."""
    ways = [name.split(".") for name in modules]
    folders = {".".join(way[:depth]) for way in ways for depth in range(2, len(way))}
    text = '"""The part of {} that reads a .dgs stream."""\n'
    return {f"{folder.replace('.', '/')}/__init__.py": text.format(folder).encode() for folder in sorted(folders)}


def _layers() -> set[str]:
    return {f"decogs.{layer}" for layer in LAYERS}


def wheel_name() -> str:
    """As wheels are named; not as the whole of decogs, which has more."""
    return f"decogs_reader-{version()}-py3-none-any.whl"


def wheel() -> bytes:
    """The reader. Source: the binary distribution format, packaging.python.org."""
    licence = (ROOT / "LICENSE").read_bytes()
    modules = bundled_modules()
    files = _folders(modules)
    for name, path in modules.items():
        files[name.replace(".", "/") + ".py"] = path.read_bytes()
    about = f"decogs_reader-{version()}.dist-info"
    files[f"{about}/METADATA"] = (
        f"Metadata-Version: 2.1\nName: decogs-reader\nVersion: {version()}\n"
        "Summary: Reads .dgs streams; a part of decogs\nLicense: Apache-2.0\n"
    ).encode()
    files[f"{about}/WHEEL"] = b"Wheel-Version: 1.0\nGenerator: decogs\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
    files[f"{about}/LICENSE"] = licence
    record = f"{about}/RECORD"
    files[record] = "".join([*(_record(name, data) for name, data in files.items()), f"{record},,\n"]).encode()
    return _zip(files)


def _record(name: str, data: bytes) -> str:
    digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
    return f"{name},sha256={digest},{len(data)}\n"


def extension() -> bytes:
    """The file that Blender installs."""
    manifest = (ROOT / "blender" / "blender_manifest.toml").read_text("utf-8")
    files = {
        "blender_manifest.toml": manifest.replace("@VERSION@", version()).replace("@WHEEL@", wheel_name()).encode(),
        "LICENSE": (ROOT / "LICENSE").read_bytes(),
        f"wheels/{wheel_name()}": wheel(),
    }
    files |= {path.name: path.read_bytes() for path in addon_modules()}
    return _zip(files)


def _zip(files: dict[str, bytes]) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name, _EARLIEST), data, zipfile.ZIP_DEFLATED)
    return packed.getvalue()


def main(words: list[str]) -> None:
    """Writes the extension where asked."""
    if len(words) != 1:
        raise SystemExit("usage: python blender/build.py ZIP")
    path = Path(words[0])
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(extension())
    print(f"{path}: {path.stat().st_size} bytes, {len(bundled_modules())} modules of decogs {version()}")


if __name__ == "__main__":
    main(sys.argv[1:])
