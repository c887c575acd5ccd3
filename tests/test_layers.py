"""The arrows formats <- codec <- decoder <- rig <- encoder <- bench hold, and the check on them sees a breach."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LAYERS = ("formats", "codec", "decoder", "rig", "encoder", "takes", "bench")


@pytest.fixture
def copied_house(tmp_path: Path) -> Path:
    """The modules of all layers as a plain package tree, so that a breach can be planted in it."""
    for layer in LAYERS:
        ignore = shutil.ignore_patterns("__pycache__", "*.so", "kernel")
        shutil.copytree(ROOT / layer, tmp_path / "decogs" / layer, ignore=ignore)
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def check_contracts(folder: Path) -> subprocess.CompletedProcess[str]:
    """import-linter over the tree in ``folder``, which comes before any installed decogs."""
    program = "from importlinter.cli import lint_imports_command as main; main(['--no-cache', '--no-logo'])"
    environment = {**os.environ, "PYTHONPATH": str(folder), "COLUMNS": "200"}
    command = [sys.executable, "-c", program]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def test_contracts_hold(copied_house: Path) -> None:
    result = check_contracts(copied_house)
    assert result.returncode == 0, result.stdout + result.stderr
    assert "9 kept, 0 broken" in result.stdout


@pytest.mark.parametrize(
    ("module", "forbidden"),
    [
        ("formats/splats.py", "decogs.codec"),
        ("codec/__init__.py", "decogs.decoder"),
        ("decoder/rasterise/native.py", "decogs.encoder.backends"),
        ("decoder/subject/hull.py", "decogs.rig.pictures.ingest"),
        ("rig/stage/stage.py", "decogs.encoder.settings.frame"),
        ("rig/mattes/mattes.py", "decogs.rig.pictures.ingest"),
        ("formats/rigs/n3dv.py", "torch"),
        ("decoder/__init__.py", "torch"),
        ("encoder/backends/cuda/optimiser.py", "decogs.encoder.backends.cpu.stretch"),
        ("encoder/backends/psnr.py", "decogs.bench.measures.metrics"),
        ("encoder/settings/frame.py", "decogs.encoder.training.method"),
        ("bench/questions/effects.py", "decogs.bench.tables.differences"),
    ],
)
def test_contracts_see_a_planted_breach(copied_house: Path, module: str, forbidden: str) -> None:
    with (copied_house / "decogs" / module).open("a", encoding="utf-8") as file:
        file.write(f"\n\ndef planted() -> None:\n    import {forbidden}\n")
    result = check_contracts(copied_house)
    importer = ".".join(["decogs", *Path(module).with_suffix("").parts]).removesuffix(".__init__")
    assert result.returncode == 1, result.stdout + result.stderr
    assert f"{importer} -> {forbidden}" in result.stdout


@pytest.mark.parametrize("layer", LAYERS)
def test_no_layer_has_a_second_identity(layer: str) -> None:
    """A bare ``import codec`` would run the module twice: its classes would not be those of ``decogs.codec``."""
    assert layer not in sys.modules
    program = f"import importlib.util, sys; sys.exit(importlib.util.find_spec({layer!r}) is not None)"
    # -I: neither the current folder nor PYTHONPATH, so that only what is installed counts.
    assert subprocess.run([sys.executable, "-I", "-c", program], check=False).returncode == 0


def imported_names(path: Path) -> set[str]:
    """First parts of all absolute imports in a file."""
    nodes = list(ast.walk(ast.parse(path.read_text("utf-8"))))
    plain = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    named = {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom) and node.level == 0}
    return {name.partition(".")[0] for name in plain | named}


@pytest.mark.parametrize("folder", [*LAYERS, "tests"])
def test_no_file_imports_a_bare_layer_or_pickle(folder: str) -> None:
    """Unpickling a stranger's file runs the stranger's code. (ruff cannot ban the bare names: it takes a relative
    import inside ``formats/`` for one of ``formats``.)"""
    files = sorted((ROOT / folder).rglob("*.py"))
    assert files
    found = {str(path): imported_names(path) & {*LAYERS, "pickle", "marshal", "shelve"} for path in files}
    assert not {path: names for path, names in found.items() if names}
