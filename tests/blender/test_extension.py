"""The Blender extension as far as it goes without Blender: what is in the zip, and that the reader in it reads."""

from __future__ import annotations

import ast
import base64
import csv
import hashlib
import io
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import zstandard

from decogs.decoder import open_stream
from decogs.formats.splats import SH_C0

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[2]
STREAM = ROOT / "tests" / "canary" / "emergence.dgs"

# What Blender has not, on any system; `resource` and `fcntl` are missing on Windows, which the reader is told it is on.
READING = """
import sys
import types

for name in ("cv2", "torch", "pxr", "OpenEXR", "tqdm", "resource", "fcntl", "bpy"):
    sys.modules[name] = None
wheel, folder, stream, *installed = sys.argv[1:]
sys.path[:0] = [wheel, *installed]
package = types.ModuleType("addon")
package.__path__ = [folder]
sys.modules["addon"] = package
system, sys.platform, sys.modules["msvcrt"] = sys.platform, "win32", types.ModuleType("msvcrt")
import decogs.formats.system.operating_systems
sys.platform = system
decogs.formats.system.operating_systems.sys = types.SimpleNamespace(platform="win32")
import decogs.decoder.reading.stream
assert decogs.decoder.reading.stream.__file__.startswith(wheel), decogs.decoder.reading.stream.__file__
import addon.playback
import numpy as np

played = addon.playback.Playback(stream, lambda damage: sys.exit(str(damage)))
for index in (2, 0, 1, 99, -3):
    frame = played.frame(index)
    print(index, len(frame.ids), float(frame.positions.astype(np.float64).sum()))
"""


@pytest.fixture(scope="module")
def extension(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("extension") / "decogs.zip"
    built = subprocess.run(
        [sys.executable, "-I", "-S", str(ROOT / "blender" / "build.py"), str(path)], capture_output=True, text=True
    )
    assert built.returncode == 0, built.stderr
    return path


def wheel_of(extension: Path) -> bytes:
    with zipfile.ZipFile(extension) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".whl"))
        return archive.read(name)


def test_the_manifest_is_what_blender_asks_for(extension: Path) -> None:
    """Source: Blender's manual, "How to Create Extensions": the required fields and their values."""
    with zipfile.ZipFile(extension) as archive:
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
        names = archive.namelist()
    required = {"schema_version", "id", "version", "name", "tagline", "maintainer", "type", "blender_version_min"}
    assert required | {"license"} <= set(manifest)
    assert (manifest["schema_version"], manifest["id"], manifest["type"]) == ("1.0.0", "decogs", "add-on")
    assert manifest["blender_version_min"] == "4.2.0"
    assert manifest["version"] == tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert len(manifest["tagline"]) <= 64
    assert manifest["tagline"][-1].isalnum() or manifest["tagline"][-1] in ")]}"
    assert [name.removeprefix("./") for name in manifest["wheels"]] == [n for n in names if n.endswith(".whl")]
    assert "__init__.py" in names


def test_the_same_sources_make_the_same_bytes(extension: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.zip"
    subprocess.run([sys.executable, str(ROOT / "blender" / "build.py"), str(again)], check=True, capture_output=True)
    assert again.read_bytes() == extension.read_bytes()


def test_the_wheel_is_the_reader_unchanged_and_no_more(extension: Path) -> None:
    with zipfile.ZipFile(io.BytesIO(wheel_of(extension))) as archive:
        contents = {name: archive.read(name) for name in archive.namelist()}
    (record,) = (name for name in contents if name.endswith("/RECORD"))
    rows = {name: (digest, size) for name, digest, size in csv.reader(contents[record].decode().splitlines())}
    assert set(rows) == set(contents)
    for name, data in contents.items():
        if name != record:
            digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).decode().rstrip("=")
            assert rows[name] == (f"sha256={digest}", str(len(data)))
    modules = {name for name in contents if name.endswith(".py") and not name.endswith("__init__.py")}
    assert "decogs/decoder/reading/stream.py" in modules
    assert not {name for name in modules if "encoder" in name or "rasterise" in name or "usd" in name}
    assert not {name for name in contents if name.endswith((".so", ".pyd", ".dll"))}
    for name in modules:
        assert contents[name] == (ROOT / name.removeprefix("decogs/")).read_bytes(), name


def test_the_reader_reads_without_what_blender_has_not(extension: Path, tmp_path: Path) -> None:
    wheel = tmp_path / "installed"
    zipfile.ZipFile(io.BytesIO(wheel_of(extension))).extractall(wheel)
    # -S, and in another folder: neither the editable installation nor the checkout is found in place of the wheel.
    installed = {str(Path(module.__file__).parents[1]) for module in (np, zstandard)}
    words = [str(wheel), str(ROOT / "blender" / "addon"), str(STREAM), *installed]
    read = subprocess.run(
        [sys.executable, "-S", "-W", "error", "-c", READING, *words],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={"PYTHONPATH": ""},
    )
    assert read.returncode == 0, read.stderr
    with open_stream(STREAM) as stream:
        frames = list(stream.frames())
    shown = [min(max(index, 0), len(frames) - 1) for index in (2, 0, 1, 99, -3)]
    for line, index in zip(read.stdout.splitlines(), shown, strict=True):
        _, count, total = line.split()
        assert int(count) == len(frames[index].splats)
        assert float(total) == float(frames[index].splats.means.astype(np.float64).sum())


def playback_module():  # type: ignore[no-untyped-def]
    import importlib.util

    path = ROOT / "blender" / "addon" / "playback.py"
    spec = importlib.util.spec_from_file_location("decogs_playback", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["decogs_playback"] = module
    spec.loader.exec_module(module)
    return module


def test_shown_values_are_activated() -> None:
    with open_stream(STREAM) as stream:
        frame = next(stream.frames())
    shown, splats = playback_module().shown(frame), frame.splats
    np.testing.assert_allclose(np.linalg.norm(shown.rotations, axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(np.log(shown.scales), splats.log_scales, atol=1e-5)
    logits = np.clip(splats.opacity_logits.astype(np.float64), -80, 80)
    np.testing.assert_allclose(shown.opacities, 1 / (1 + np.exp(-logits)), atol=1e-6)
    np.testing.assert_allclose(shown.colours, np.maximum(0.5 + SH_C0 * splats.sh[:, 0], 0), atol=1e-6)


@pytest.mark.parametrize("first", [0, 12345, 2**40])
def test_a_fraction_of_ids_in_a_row_lies_below_it(first: int) -> None:
    """Evenly spread: of 10 000 the share is off by 0.005 at most, where chance alone would give 0.009 (two sigma)."""
    ranks = playback_module().ranks(np.arange(first, first + 10_000, dtype=np.int64))
    assert ranks.min() >= 0
    assert ranks.max() < 1
    for fraction in (0.1, 0.25, 0.5, 0.9):
        assert abs((ranks < fraction).mean() - fraction) < 0.005


def test_every_import_of_decogs_is_a_module_of_the_wheel(extension: Path) -> None:
    """What is imported when a button is pressed is in the zip, too."""
    with zipfile.ZipFile(io.BytesIO(wheel_of(extension))) as archive:
        inside = {name.removesuffix(".py").replace("/", ".") for name in archive.namelist()}
    for path in (ROOT / "blender" / "addon").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("decogs."):
                assert node.module in inside, f"{path.name} imports {node.module}"
