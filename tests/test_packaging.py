"""What pyproject.toml, constraints.txt and CHANGELOG.md say agrees with the checkout and with each other."""

from __future__ import annotations

import os
import re
import runpy
import shutil
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from decogs.formats.rigs import open_rig, read_frames
from decogs.formats.system.kernels import INSTRUCTION_SETS, best_instruction_set, kernel_path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
LAYERS = ("formats", "codec", "decoder", "rig", "encoder", "takes", "bench")


@pytest.fixture(scope="module")
def pyproject() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))


def requirements(pyproject: dict[str, Any]) -> list[Requirement]:
    project = pyproject["project"]
    extras = project["optional-dependencies"].values()
    lines = [*project["dependencies"], *(line for extra in extras for line in extra)]
    given = [Requirement(line) for line in [*lines, *pyproject["build-system"]["requires"]]]
    return [one for one in given if one.name != "decogs"]  # as extras build upon each other


def pins() -> dict[str, list[Requirement]]:
    lines = [line for line in (ROOT / "constraints.txt").read_text("utf-8").splitlines() if line and line[0] != "#"]
    by_name: dict[str, list[Requirement]] = {}
    for pin in map(Requirement, lines):
        by_name.setdefault(canonicalize_name(pin.name), []).append(pin)
    return by_name


def test_packages_list_every_folder_with_modules(pyproject: dict[str, Any]) -> None:
    """A folder missing from the list works in an editable install and is missing from the wheel only."""
    folders = {path.parent.relative_to(ROOT) for layer in LAYERS for path in (ROOT / layer).rglob("*.py")}
    assert sorted(pyproject["tool"]["setuptools"]["packages"]) == sorted(
        ["decogs", *(".".join(["decogs", *folder.parts]) for folder in folders)]
    )


def test_every_layer_is_mapped_and_typed(pyproject: dict[str, Any]) -> None:
    mapping = pyproject["tool"]["setuptools"]["package-dir"]
    assert mapping == {"decogs": "decogs"} | {f"decogs.{layer}": layer for layer in LAYERS}
    assert (ROOT / "decogs" / "py.typed").is_file(), "which counts for all below it (PEP 561)"
    for layer in LAYERS:
        # The editable install and type checkers follow these links; a wheel is made by setuptools' mapping.
        assert (ROOT / "decogs" / layer).resolve() == ROOT / layer


@pytest.mark.parametrize("python_version", ["3.10", "3.11", "3.13"])
def test_every_requirement_is_pinned_within_its_range(pyproject: dict[str, Any], python_version: str) -> None:
    by_name = pins()
    for requirement in requirements(pyproject):
        candidates = by_name.get(canonicalize_name(requirement.name), [])
        chosen = [p for p in candidates if p.marker is None or p.marker.evaluate({"python_version": python_version})]
        assert len(chosen) == 1, f"constraints.txt pins {requirement.name} {len(chosen)} times on {python_version}"
        (specifier,) = chosen[0].specifier
        assert specifier.operator == "=="
        assert requirement.specifier.contains(specifier.version), f"{chosen[0]} is outside {requirement}"


def test_torch_is_pinned_by_number_only() -> None:
    """A local version (+cpu, +cu130) in the pin would shut out the machine's own choice of device."""
    assert [str(pin) for pin in pins()["torch"]] == ["torch==2.13.0"]


def test_one_version(pyproject: dict[str, Any]) -> None:
    version = pyproject["project"]["version"]
    headings = re.findall(r"^## \[(\d[^\]]*)\]", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    assert metadata.version("decogs") == version
    assert headings[0] == version


def test_the_sample_rig_is_whole() -> None:
    rig = open_rig(ROOT / "tests" / "demo" / "workbench")
    assert [camera.name for camera in rig.cameras] == [f"cam{number:02d}" for number in range(13)]
    assert (rig.layout, rig.fps, rig.frame_count) == ("n3dv", 30.0, 9)
    assert [frame for frame, _ in read_frames(rig)] == list(range(9))
    assert sum(path.stat().st_size for path in rig.path.iterdir()) < 3_000_000


def build_with(
    compilers: dict[str, str], folder: Path, *, what: str = "build_ext", **environment: str
) -> subprocess.CompletedProcess[str]:
    """A build of the kernels where these, scripts of sh by name, are the only programs. ``what``: the command."""
    for name, script in compilers.items():
        (folder / name).write_text(f"#!/bin/sh\n{script}\n")
        (folder / name).chmod(0o755)
    left_out = ("CC", "CXX", "DECOGS_KERNEL_CACHE")
    given = {name: value for name, value in os.environ.items() if name not in left_out}
    return subprocess.run(
        [
            sys.executable,
            "setup.py",
            what,
            "--build-lib",
            str(folder / "built"),
            "--build-temp",
            str(folder / "objects"),
        ],
        cwd=ROOT,
        env={**given, "PATH": str(folder), **environment},
        capture_output=True,
        text=True,
        timeout=60,
    )


# A compiler for which every library is this one.
COPYING = (
    f'for name; do :; done; {shutil.which("cp")} {kernel_path(ROOT / "formats" / "colours", "_ycbcr", "base")} "$name"'
)


@pytest.mark.parametrize(("asked", "built"), [("", {"base", best_instruction_set()}), ("all", {*INSTRUCTION_SETS})])
def test_kernels_are_built_for_this_machine_or_for_all(asked: str, built: set[str], tmp_path: Path) -> None:
    """The plain ones always: what was installed here may be run on a lesser machine."""
    run = build_with({"g++": COPYING}, tmp_path, DECOGS_KERNELS=asked)
    assert run.returncode == 0, run.stderr
    sets: dict[str, set[str]] = {}
    for library in (tmp_path / "built").rglob("*.abi3.so"):
        kernel, _, instruction_set = library.name.partition(".")[0].rpartition("_")
        sets.setdefault(kernel, set()).add(instruction_set)
    assert sets == dict.fromkeys(("_ycbcr", "_forward", "_training", "_cache"), built)


def test_kernels_compiled_on_windows_bring_what_mingw_has(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python looks for DLLs neither in PATH nor in MinGW-w64's folder."""
    monkeypatch.setattr(sys, "platform", "win32")
    assert "-static" in runpy.run_path(str(ROOT / "setup.py"))["SHARED"]


def test_modules_that_are_gone_do_not_come_back(tmp_path: Path) -> None:
    """pip builds in the checkout, where what an earlier build copied still lies."""
    gone = tmp_path / "built" / "decogs" / "gone.py"
    gone.parent.mkdir(parents=True)
    gone.touch()
    run = build_with({"g++": COPYING}, tmp_path, what="build")
    assert run.returncode == 0, run.stderr
    assert gone.with_name("entry.py").exists()
    assert not gone.exists()


TOO_OLD = 'case "$*" in *c++17*) echo "unrecognized -std=c++17" >&2; exit 1;; esac'


@pytest.mark.parametrize(
    ("compilers", "environment", "said"),
    [
        ({}, {}, "a C++ compiler is missing; install g++ 11 or later"),
        ({"gcc": "exit 0"}, {}, "a C++ compiler is missing; install g++ 11 or later"),
        ({"g++": TOO_OLD}, {}, "the C++ compiler g++"),
        ({"clang++": "exit 1"}, {}, "the C++ compiler clang++ cannot compile decogs' kernels"),
        ({"g++": 'for name; do :; done; : > "$name"'}, {}, "the C++ compiler g++ cannot compile decogs' kernels"),
        ({"clang++": "exit 0"}, {"CXX": "mycc -m64"}, "a C++ compiler is missing: CXX names mycc -m64; install"),
    ],
)
def test_without_a_compiler_the_build_ends_in_one_sentence(
    compilers: dict[str, str], environment: dict[str, str], said: str, tmp_path: Path
) -> None:
    run = build_with(compilers, tmp_path, **environment)
    assert run.returncode == 1
    last = run.stderr.splitlines()[-1]
    assert last.startswith(f"error: {said}")
    assert last.endswith("or clang 12 or later, and try again")
    assert "Traceback" not in run.stderr


def test_the_first_compiler_that_can_is_taken(tmp_path: Path) -> None:
    """One that is too old does not keep a newer one from being found."""
    run = build_with({"g++": TOO_OLD, "clang++": f'echo "$*" >> {tmp_path}/log; {COPYING}'}, tmp_path)
    compiled = (tmp_path / "log").read_text()
    assert "ycbcr.cpp" in compiled, run.stderr
