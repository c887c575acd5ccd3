"""Builds the native kernels, one shared library per instruction set; everything else is in pyproject.toml.

The libraries have a plain C interface and are loaded with ctypes, so they need neither Python's headers nor its ABI.
One library per instruction set (rather than one library with three copies) keeps the linker from merging inline
functions that were compiled for a newer machine into code that an older one runs. For the same reason each set has a
C++ namespace of its own: the loader shares thread-local variables of one name between libraries, and a process may load
several, as tests do.

With DECOGS_TARGET, a name of TARGETS, the wheel is of that platform: Zig compiles and links, on whatever machine
(``make wheels``).
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from dataclasses import dataclass
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build import build
from setuptools.command.build_ext import build_ext
from setuptools.errors import CompileError

COMMON_FLAGS = [
    "-std=c++17",
    "-O3",
    "-g0",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fvisibility=hidden",
    "-fvisibility-inlines-hidden",
]
X86_SETS = {
    "base": ["-march=x86-64-v2"],
    "avx2": ["-march=x86-64-v3"],
    "avx512": ["-march=x86-64-v4", "-mprefer-vector-width=512"],
}
KERNELS = {
    "decogs.formats.colours._ycbcr": ("formats/colours/kernel", "ycbcr.cpp"),
    "decogs.decoder.rasterise._forward": ("decoder/rasterise/kernel", "forward.cpp"),
    "decogs.encoder.backends.cpu._training": ("encoder/backends/cpu/kernel", "training.cpp"),
    "decogs.encoder.methods.transformation_cache._cache": ("encoder/methods/transformation_cache/kernel", "cache.cpp"),
}
ASKED = "decogs.formats.colours._ycbcr"
"""The kernel whose base build says which instruction sets a machine runs."""


@dataclass(frozen=True)
class Target:
    """A platform that wheels are built for from any other.

    ``zig``: its name there, with the oldest C library or system that will do. ``tag``: the wheel's. ``suffix``: that of
    Python's own libraries there.
    """

    zig: str
    tag: str
    suffix: str = ".abi3.so"


TARGETS = {
    "linux-x86_64": Target("x86_64-linux-gnu.2.17", "manylinux_2_17_x86_64"),
    "linux-aarch64": Target("aarch64-linux-gnu.2.17", "manylinux_2_17_aarch64"),
    "windows-x86_64": Target("x86_64-windows-gnu", "win_amd64", ".pyd"),
    "macos-x86_64": Target("x86_64-macos.11.0", "macosx_11_0_x86_64"),
    "macos-arm64": Target("aarch64-macos.11.0", "macosx_11_0_arm64"),
}
TARGET = TARGETS[os.environ["DECOGS_TARGET"]] if os.environ.get("DECOGS_TARGET") else None


def is_x86() -> bool:
    return TARGET.zig.startswith("x86_64") if TARGET else platform.machine() in ("x86_64", "AMD64")


def is_windows() -> bool:
    return TARGET.suffix == ".pyd" if TARGET else sys.platform == "win32"


INSTRUCTION_SETS = X86_SETS if is_x86() else {"base": []}
CODE = [] if is_windows() else ["-fPIC", "-pthread"]
SHARED = ["-shared", *CODE]
if TARGET:
    SHARED.append("-Wl,-s")
elif is_windows():
    SHARED.append("-static")  # Python looks for no other DLLs where MinGW-w64 has its own.


class BuildAnew(build):
    """Without what an earlier build left in the same checkout: modules that are gone would be installed again."""

    def run(self) -> None:
        shutil.rmtree(self.build_lib, ignore_errors=True)
        super().run()


class BuildKernels(build_ext):
    """Compiles and links the libraries by commands of our own, which are the same for every platform.

    With DECOGS_KERNEL_CACHE, a folder, what was built of the same sources by the same commands is not built again: the
    checks install the project twice, from the tree and as the wheel that users get.
    """

    def run(self) -> None:
        """CompileError, of one sentence, where no compiler can."""
        self.command = chosen_compiler()
        super().run()

    def finalize_options(self) -> None:
        """An option of ``setup`` would be lost in editable installs, which set this command up twice."""
        build_ext.finalize_options(self)
        self.parallel = self.parallel or os.cpu_count() or 1

    def build_extensions(self) -> None:
        """The plain set and the widest that this machine runs; by DECOGS_KERNELS=all, and for another platform, all.

        The plain one is what is left if the installation moves to a lesser machine.
        """
        if os.environ.get("DECOGS_KERNELS") != "all" and not TARGET:
            asked = next(ext for ext in self.extensions if ext.name == f"{ASKED}_base")
            self.build_extension(asked)
            # Loaded as a copy: the library itself is about to be built once more.
            with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
                copied = shutil.copy(self.get_ext_fullpath(asked.name), folder)
                widest = list(INSTRUCTION_SETS)[ctypes.CDLL(copied).decogs_instruction_set()]
            self.extensions = [ext for ext in self.extensions if ext.name.endswith(("_base", f"_{widest}"))]
        super().build_extensions()

    def build_extension(self, ext: Extension) -> None:
        library = Path(self.get_ext_fullpath(ext.name))
        compiling = [*self.command, *ext.extra_compile_args, *(f"-I{folder}" for folder in ext.include_dirs)]
        compiling += [*given("CPPFLAGS"), *given("CXXFLAGS"), "-c", *ext.sources]
        linking = [*self.command, *ext.extra_link_args, *given("LDFLAGS")]
        kept = kept_as(compiling + linking, [*ext.sources, *sorted(ext.depends)])
        if kept is not None and kept.exists():
            put(kept, library)
            return
        with tempfile.TemporaryDirectory() as folder:
            compiled, linked = Path(folder, "kernel.o"), Path(folder, library.name)
            self.spawn([*compiling, "-o", str(compiled)])
            # Linked without the instruction set: what comes from the C++ library is for every machine.
            self.spawn([*linking, str(compiled), "-o", str(linked)])
            if TARGET and is_windows():
                forget_time(linked)
            put(linked, library)
        if kept is not None:
            put(library, kept)

    def get_ext_filename(self, fullname: str) -> str:
        name = super().get_ext_filename(fullname)
        return name if TARGET is None else str(Path(*fullname.split("."))) + TARGET.suffix


def forget_time(library: Path) -> None:
    """Clears the time of linking in a library of Windows: Zig has no option for it. Source: PE format, COFF header."""
    data = bytearray(library.read_bytes())
    at = int.from_bytes(data[0x3C:0x40], "little") + 8
    data[at : at + 4] = bytes(4)
    library.write_bytes(data)


def put(source: Path, target: Path) -> None:
    """Copies a library in one step: what runs with the one that was there goes on with that."""
    target.parent.mkdir(parents=True, exist_ok=True)
    growing = target.with_name(f"{target.name}.{os.getpid()}.part")
    shutil.copyfile(source, growing)
    growing.chmod(0o755)
    growing.replace(target)


def given(variable: str) -> list[str]:
    """More options for the compiler, as packagers set them."""
    return shlex.split(os.environ.get(variable, ""))


def kept_as(commands: list[str], files: list[str]) -> Path | None:
    """Where the cache has what these commands make of these files, or will have it."""
    if "DECOGS_KERNEL_CACHE" not in os.environ:
        return None
    made = hashlib.sha256("\n".join(word for word in commands if word != sys.executable).encode())
    for path in files:
        made.update(Path(path).read_bytes())
    return Path(os.environ["DECOGS_KERNEL_CACHE"], made.hexdigest()[:16])


def chosen_compiler() -> list[str]:
    """The compiler that CXX names, or else the first that compiles the kernels: Python's own, g++, c++, clang++."""
    if TARGET:
        return [sys.executable, "-m", "ziglang", "c++", "-target", TARGET.zig]
    named = os.environ.get("CXX")
    candidates = [named] if named else [sysconfig.get_config_var("CXX") or "g++", "g++", "c++", "clang++"]
    there = [words for command in candidates if shutil.which((words := shlex.split(command))[0])]
    able = next(filter(compiles_kernels, there), None)
    if able is not None:
        return able
    if there:
        problem = f"the C++ compiler {there[0][0]} cannot compile decogs' kernels (C++17 for {platform.machine()})"
    else:
        problem = f"a C++ compiler is missing{f': CXX names {named}' if named else ''}"
    raise CompileError(f"{problem}; {how_to_get_one()}, and try again")


def how_to_get_one() -> str:
    """What to install, on this system."""
    if sys.platform == "darwin":
        return "install Apple's (xcode-select --install)"
    if sys.platform == "win32":
        return "install g++ 11 or later (of MinGW-w64)"
    return "install g++ 11 or later (Debian, Ubuntu: apt install g++; Fedora: dnf install gcc-c++) or clang 12 or later"


def compiles_kernels(command: list[str]) -> bool:
    """Whether a compiler knows the language and the instruction sets, and links libraries that Python can load."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        source, library = Path(folder, "probe.cpp"), f"{folder}/probe.so"
        source.write_text("#include <new>\n#include <optional>\nstd::optional<int*> probe() { return new int; }\n")
        for flags in INSTRUCTION_SETS.values():
            compiled = [*command, *COMMON_FLAGS, *flags, *SHARED, str(source), "-o", library]
            if subprocess.run(compiled, capture_output=True).returncode:
                return False
        try:
            ctypes.CDLL(library)
        except OSError:
            return False
    return True


def flags_of(instruction_set: str) -> list[str]:
    """What tells the compiler of this set; Zig spells processors by its own rules."""
    flags = INSTRUCTION_SETS[instruction_set]
    return [flag.replace("x86-64-", "x86_64_") for flag in flags] if TARGET else flags


def names_itself(name: str) -> list[str]:
    """What keeps Zig from writing the folder that a library for macOS was linked in into it."""
    if TARGET is None or "-macos" not in TARGET.zig:
        return []
    return [f"-Wl,-install_name,@rpath/{name.rpartition('.')[2]}{TARGET.suffix}"]


def kernels() -> list[Extension]:
    headers = [str(path) for folder, _ in KERNELS.values() for path in sorted(Path(folder).glob("*.h"))]
    return [
        Extension(
            f"{name}_{instruction_set}",
            [f"{folder}/{source}"],
            include_dirs=["decoder/rasterise/kernel", "encoder/backends/cpu/kernel"],
            depends=headers,
            extra_compile_args=[
                *COMMON_FLAGS,
                *CODE,
                f"-Ddecogs=decogs_{instruction_set}",
                *flags_of(instruction_set),
            ],
            extra_link_args=[*SHARED, *names_itself(f"{name}_{instruction_set}")],
            language="c++",
            py_limited_api=True,
        )
        for name, (folder, source) in KERNELS.items()
        for instruction_set in INSTRUCTION_SETS
    ]


if __name__ == "__main__":
    setup(
        ext_modules=kernels(),
        cmdclass={"build": BuildAnew, "build_ext": BuildKernels},
        options={"bdist_wheel": {"py_limited_api": "cp310"} | ({"plat_name": TARGET.tag} if TARGET else {})},
    )
