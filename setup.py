"""Builds the native kernels, one shared library per instruction set; everything else is in pyproject.toml.

The libraries have a plain C interface and are loaded with ctypes, so they need neither Python's headers nor its ABI.
One library per instruction set (rather than one library with three copies) keeps the linker from merging inline
functions that were compiled for a newer machine into code that an older one runs. For the same reason each set has a
C++ namespace of its own: the loader shares thread-local variables of one name between libraries, and a process may load
several, as tests do.
"""

from __future__ import annotations

import copy
import hashlib
import os
import platform
import re
import shlex
import shutil
import subprocess
import sysconfig
import tempfile
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext
from setuptools.errors import CompileError

COMMON_FLAGS = [
    "-std=c++17",
    "-O3",
    "-g0",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fvisibility-inlines-hidden",
    "-pthread",
]
INSTRUCTION_SETS = {"base": []}
if platform.machine() in ("x86_64", "AMD64"):
    INSTRUCTION_SETS = {
        "base": ["-march=x86-64-v2"],
        "avx2": ["-march=x86-64-v3"],
        "avx512": ["-march=x86-64-v4", "-mprefer-vector-width=512"],
    }
# By Linux's names; the kernels ask the same of the processor (decogs_instruction_set).
NEEDED_FLAGS = {
    "avx2": {"avx2", "fma", "bmi2"},
    "avx512": {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"},
}
KERNELS = {
    "decogs.formats._ycbcr": ("formats/kernel", "ycbcr.cpp"),
    "decogs.decoder.rasterise._forward": ("decoder/rasterise/kernel", "forward.cpp"),
    "decogs.encoder.backends.cpu._training": ("encoder/backends/cpu/kernel", "training.cpp"),
    "decogs.encoder.methods.transformation_cache._cache": ("encoder/methods/transformation_cache/kernel", "cache.cpp"),
}


class BuildKernels(build_ext):
    """Gives every library an object folder of its own: several are built from one source, side by side.

    With DECOGS_KERNEL_CACHE, a folder, what was built of the same sources with the same flags is not built again: the
    checks install the project twice, from the tree and as the wheel that users get.
    """

    def run(self) -> None:
        """Compiles with a compiler that can; CompileError, of one sentence, where there is none."""
        os.environ["CXX"] = chosen_compiler()
        super().run()

    def finalize_options(self) -> None:
        """An option of ``setup`` would be lost in editable installs, which set this command up twice."""
        build_ext.finalize_options(self)
        self.parallel = self.parallel or os.cpu_count() or 1

    def build_extension(self, ext: Extension) -> None:
        mine, library = copy.copy(self), Path(self.get_ext_fullpath(ext.name))
        mine.build_temp = str(Path(self.build_temp) / ext.name)
        kept = self._kept(ext)
        if kept is not None and kept.exists():
            library.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(kept, library)
            return
        build_ext.build_extension(mine, ext)
        if kept is not None:
            kept.parent.mkdir(parents=True, exist_ok=True)
            growing = kept.with_suffix(".part")
            shutil.copyfile(library, growing)
            growing.replace(kept)

    def _kept(self, ext: Extension) -> Path | None:
        """Where the cache has this library, or will have it."""
        if "DECOGS_KERNEL_CACHE" not in os.environ:
            return None
        said = [ext.name, *self.compiler.compiler_so_cxx, *ext.extra_compile_args, *ext.extra_link_args]
        made = hashlib.sha256("\n".join(said).encode())
        for path in [*ext.sources, *sorted(ext.depends)]:
            made.update(Path(path).read_bytes())
        return Path(os.environ["DECOGS_KERNEL_CACHE"], made.hexdigest()[:16])


def chosen_compiler() -> str:
    """The compiler that CXX names, or else the first that compiles the kernels: Python's own, g++, c++, clang++."""
    named = os.environ.get("CXX")
    candidates = [named] if named else [sysconfig.get_config_var("CXX") or "g++", "g++", "c++", "clang++"]
    there = [command for command in candidates if shutil.which(shlex.split(command)[0])]
    able = next(filter(compiles_kernels, there), None)
    if able is not None:
        return able
    if there:
        problem = f"the C++ compiler {there[0]} cannot compile decogs' kernels (C++17 for {platform.machine()})"
    else:
        problem = f"a C++ compiler is missing{f': CXX names {named}' if named else ''}"
    raise CompileError(
        f"{problem}; install g++ 11 or later (Debian, Ubuntu: apt install g++; Fedora: dnf install gcc-c++) "
        "or clang 12 or later, and try again"
    )


def compiles_kernels(command: str) -> bool:
    """Whether a compiler knows the language and the instruction sets, and finds the C++ library."""
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder, "probe.cpp")
        source.write_text("#include <optional>\nstd::optional<int> probe() { return 1; }\n")
        for flags in INSTRUCTION_SETS.values():
            compiled = [*shlex.split(command), *COMMON_FLAGS, *flags, "-fPIC", "-shared", str(source), "-o"]
            if subprocess.run([*compiled, f"{folder}/probe.so"], capture_output=True).returncode:
                return False
    return True


def of_this_machine() -> str:
    """The widest set that it runs, by the flags that Linux tells."""
    listed = re.search(r"^flags\s*:(.*)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    flags = set(listed[1].split()) if listed else set()
    runs = ["base", *(name for name, needed in NEEDED_FLAGS.items() if needed <= flags)]
    return runs[-1]


def chosen(name: str) -> dict[str, list[str]]:
    """The sets to build a kernel for: all, or with DECOGS_KERNELS=native this machine's and what finds out which it is.

    Compiling for all takes minutes, which who only wants to see the demo need not wait.
    """
    if os.environ.get("DECOGS_KERNELS") != "native" or len(INSTRUCTION_SETS) == 1:
        return INSTRUCTION_SETS
    wanted = {of_this_machine()} | ({"base"} if name.endswith("._ycbcr") else set())
    return {name: flags for name, flags in INSTRUCTION_SETS.items() if name in wanted}


def kernels() -> list[Extension]:
    headers = [str(path) for folder, _ in KERNELS.values() for path in sorted(Path(folder).glob("*.h"))]
    return [
        Extension(
            f"{name}_{instruction_set}",
            [f"{folder}/{source}"],
            include_dirs=["decoder/rasterise/kernel", "encoder/backends/cpu/kernel"],
            depends=headers,
            extra_compile_args=[*COMMON_FLAGS, f"-Ddecogs=decogs_{instruction_set}", *flags],
            extra_link_args=["-pthread"],
            language="c++",
            py_limited_api=True,
        )
        for name, (folder, source) in KERNELS.items()
        for instruction_set, flags in chosen(name).items()
    ]


setup(
    ext_modules=kernels(),
    cmdclass={"build_ext": BuildKernels},
    options={"bdist_wheel": {"py_limited_api": "cp310"}},
)
