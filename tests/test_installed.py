"""What must hold of an installed decogs: run in the development environment, and again in one that holds only the
wheel and no torch (make wheel-check)."""

from __future__ import annotations

import ctypes
import importlib.util
import json
import platform
import subprocess
import sys
import sysconfig
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from decogs.formats.system.kernels import INSTRUCTION_SETS, kernel_path

ROOT = Path(__file__).resolve().parents[1]
LAYERS = ("formats", "codec", "decoder", "rig", "encoder", "takes", "bench")
INSTALLED = metadata.distribution("decogs")


def is_editable() -> bool:
    direct_url = json.loads(INSTALLED.read_text("direct_url.json") or "{}")
    return bool(direct_url.get("dir_info", {}).get("editable"))


def instruction_sets() -> list[str]:
    """All in the development environment; pip compiles the plain one and the widest that this machine has."""
    if is_editable():
        return ["base", "avx2", "avx512"] if platform.machine() in ("x86_64", "AMD64") else ["base"]
    there = [
        name for name in INSTRUCTION_SETS if kernel_path(layer_folder("formats") / "colours", "_ycbcr", name).exists()
    ]
    return there or ["base"]


def layer_folder(layer: str) -> Path:
    """Where the installation has a layer, found without importing it."""
    spec = importlib.util.find_spec(f"decogs.{layer}")
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).resolve().parent


def modules_in(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*.py"))


@pytest.mark.parametrize("layer", LAYERS)
def test_a_layer_is_installed_whole(layer: str) -> None:
    """No module of the checkout is missing and none is left over from an older build."""
    expected = ROOT / layer if is_editable() else Path(str(INSTALLED.locate_file("decogs"))).resolve() / layer
    assert layer_folder(layer) == expected
    assert modules_in(expected) == modules_in(ROOT / layer)


def test_nothing_else_is_installed() -> None:
    """Neither tests nor a generic name such as ``codec`` lands in site-packages."""
    files = INSTALLED.files
    assert files is not None
    tops = {file.parts[0] for file in files if file.parts[0] != ".."}  # ".." leads to bin/ and share/
    ours = {top for top in tops if not top.startswith(("decogs-", "__editable__"))}
    assert ours <= {"decogs", "__pycache__"}
    assert not [str(file) for file in files if file.parts[0] == "decogs" and "test" in str(file)]


def test_the_specification_is_installed() -> None:
    assert (layer_folder("formats") / "SPEC.md").read_bytes() == (ROOT / "formats" / "SPEC.md").read_bytes()


def test_the_player_is_installed_as_it_was_built() -> None:
    """Users have no Node: the page comes with the wheel, whole."""
    built, installed = (folder / "viewing" / "page" for folder in (ROOT / "decoder", layer_folder("decoder")))
    names = sorted(path.name for path in built.iterdir())
    scripts = {f"decogs-{name}.js" for name in ("player", "worker", "controls", "recorded", "exact")}
    assert {"index.html", "decogs-exact.wasm", "decogs-kernel.wasm", "decogs-zstd.wasm"} | scripts <= set(names)
    assert sorted(path.name for path in installed.iterdir()) == names
    for name in names:
        assert (installed / name).read_bytes() == (built / name).read_bytes()


@pytest.mark.parametrize("instruction_set", instruction_sets())
@pytest.mark.parametrize(
    ("layer", "package", "stem", "function"),
    [
        ("formats", "colours", "_ycbcr", "decogs_rgb_of_ycbcr"),
        ("decoder", "rasterise", "_forward", "decogs_render"),
        ("encoder", "backends/cpu", "_training", "decogs_backward"),
        ("encoder", "methods/transformation_cache", "_cache", "decogs_cache_step"),
    ],
)
def test_the_kernels_are_installed(layer: str, package: str, stem: str, function: str, instruction_set: str) -> None:
    """The wheel is built from the sdist, so this also shows that the sdist holds their sources."""
    library = ctypes.CDLL(str(kernel_path(layer_folder(layer) / package, stem, instruction_set)))
    assert hasattr(library, function)


def test_users_need_torch_for_cuda_only() -> None:
    needed = [Requirement(line) for line in metadata.requires("decogs") or []]
    markers = [requirement.marker for requirement in needed if requirement.name == "torch"]
    for extra, wanted in (("cuda", True), ("dev", True), ("", False), ("bench", False)):
        assert any(marker is None or marker.evaluate({"extra": extra}) for marker in markers) == wanted


def test_the_lower_layers_import_without_torch_and_encoder() -> None:
    """Every module of formats, codec and decoder, with torch and decogs.encoder made impossible to import.

    Without the extras, modules may lack their libraries, and nothing else.
    """
    program = """
import importlib.util, sys
sys.modules["torch"] = sys.modules["decogs.encoder"] = None
lacking = [name for name in ("av", "cv2", "pxr") if importlib.util.find_spec(name) is None]
for name in sys.argv[1:]:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name not in lacking:
            raise
"""
    names = [
        ".".join(["decogs", layer, *Path(module).with_suffix("").parts]).removesuffix(".__init__")
        for layer in ("formats", "codec", "decoder")
        for module in modules_in(ROOT / layer)
    ]
    command = [sys.executable, "-I", "-c", program, *names]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


def said(command: str, *options: str) -> str:
    script = Path(sysconfig.get_path("scripts")) / command
    result = subprocess.run([str(script), *options], capture_output=True, text=True, check=False)
    assert (result.returncode, result.stderr) == (0, "")
    return result.stdout


COMMANDS = sorted(entry.name for entry in INSTALLED.entry_points if entry.group == "console_scripts")


def test_there_are_these_commands() -> None:
    names = ("analyze", "bench", "calibrate", "decode", "edit", "encode", "export", "info", "join")
    names += ("make", "pack", "report", "sync", "verify", "view")
    assert [f"decogs-{name}" for name in names] == COMMANDS


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_explains_itself_and_tells_its_version(command: str) -> None:
    assert f"usage: {command}" in said(command, "--help")
    assert said(command, "--version") == f"{command} {INSTALLED.version}\n"


def test_the_package_tells_its_version() -> None:
    program = "import decogs; print(decogs.__version__)"
    result = subprocess.run([sys.executable, "-I", "-c", program], capture_output=True, text=True, check=False)
    assert (result.stdout, result.stderr) == (f"{INSTALLED.version}\n", "")


@pytest.mark.skipif(is_editable(), reason="an editable installation leaves out what is no module")
@pytest.mark.parametrize("command", COMMANDS)
def test_shells_and_man_find_what_they_need(command: str) -> None:
    """They lie in the environment's share/."""
    share = Path(sysconfig.get_path("data")) / "share"
    for name in (
        f"man/man1/{command}.1",
        f"bash-completion/completions/{command}",
        f"zsh/site-functions/_{command}",
    ):
        assert (share / name).read_bytes() == (ROOT / "share" / name).read_bytes()
