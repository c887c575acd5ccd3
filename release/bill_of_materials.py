"""What a release consists of and needs, as CycloneDX: ``python release/bill_of_materials.py FILE``.

Components that are required or optional are packages that pip installs beside decogs, in the versions that it is tested
with; those within are part of what is published: compiled into the kernels, or bundled with the player's page.
"""

from __future__ import annotations

import json
import os
import sys
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import tomllib
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parent.parent
PYTHON = {"python_version": "3.13", "python_full_version": "3.13.0"}
"""Whose versions are listed, where releases of a package suit one Python and not another."""

LLVM = "libc++, libc++abi, libunwind and compiler-rt"
WITHIN = (
    (LLVM, "llvm-project", "Apache-2.0 WITH LLVM-exception"),
    ("MinGW-w64's start-up code", "mingw-w64", "ZPL-2.1"),
)
"""What Zig links into kernels, the second for Windows only; its own version says which."""


def bill(time_committed: int) -> dict[str, Any]:
    """The document; ``time_committed``: of the sources, in seconds since 1970."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    itself = {
        "type": "application",
        "bom-ref": "decogs",
        "name": "decogs",
        "version": project["version"],
        "purl": f"pkg:pypi/decogs@{project['version']}",
        "licenses": [{"license": {"id": project["license"]}}],
    }
    components = [*_python_packages(project), *_of_the_kernels(), *_of_the_page()]
    components.sort(key=lambda component: component["bom-ref"])
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": uuid.uuid5(uuid.NAMESPACE_URL, f"{itself['purl']} {time_committed}").urn,
        "version": 1,
        "metadata": {
            "timestamp": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(time_committed)),
            "component": itself,
        },
        "components": components,
        "dependencies": [{"ref": "decogs", "dependsOn": [component["bom-ref"] for component in components]}],
    }


def _pins() -> dict[str, str]:
    """The version of every package, by its name."""
    lines = (ROOT / "constraints.txt").read_text("utf-8").splitlines()
    pins = [Requirement(line) for line in lines if line and not line.startswith("#")]
    valid = [pin for pin in pins if pin.marker is None or pin.marker.evaluate(PYTHON)]
    return {canonicalize_name(pin.name): str(next(iter(pin.specifier)).version) for pin in valid}


def _python_packages(project: dict[str, Any]) -> Iterator[dict[str, Any]]:
    pins = _pins()
    optional = [line for extra, lines in project["optional-dependencies"].items() if extra != "dev" for line in lines]
    seen: set[str] = set()
    for scope, lines in (("required", project["dependencies"]), ("optional", optional)):
        for requirement in map(Requirement, lines):
            name = canonicalize_name(requirement.name)
            if name in ("decogs", *seen) or (requirement.marker and not requirement.marker.evaluate(PYTHON)):
                continue
            seen.add(name)
            purl = f"pkg:pypi/{name}@{pins[name]}"
            parts = {"type": "library", "bom-ref": purl, "name": name, "version": pins[name], "purl": purl}
            yield parts | {"scope": scope}


def _of_the_kernels() -> Iterator[dict[str, Any]]:
    version = _pins()["ziglang"]
    for description, name, licence in WITHIN:
        yield {
            "type": "library",
            "bom-ref": f"zig-{version}/{name}",
            "name": name,
            "version": f"as in zig {version}",
            "description": description,
            "licenses": [{"expression": licence}],
            "scope": "required",
        }


def _of_the_page() -> Iterator[dict[str, Any]]:
    """The one package whose code the player bundles: Zstandard as WebAssembly."""
    version = json.loads((ROOT / "player" / "package.json").read_text("utf-8"))["devDependencies"]["zstddec"]
    purl = f"pkg:npm/zstddec@{version}"
    parts = {"type": "library", "bom-ref": purl, "name": "zstddec", "version": version, "purl": purl}
    yield parts | {"licenses": [{"expression": "MIT AND BSD-3-Clause"}], "scope": "required"}


if __name__ == "__main__":
    document = bill(int(os.environ["SOURCE_DATE_EPOCH"]))
    Path(sys.argv[1]).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
