"""Builds the native kernels, one shared library per instruction set; everything else is in pyproject.toml.

The libraries have a plain C interface and are loaded with ctypes, so they need neither Python's headers nor its ABI.
One library per instruction set (rather than one library with three copies) keeps the linker from merging inline
functions that were compiled for a newer machine into code that an older one runs. For the same reason each set has a
C++ namespace of its own: the loader shares thread-local variables of one name between libraries, and a process may load
several, as tests do.
"""

import platform
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

COMMON_FLAGS = ["-std=c++17", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fvisibility-inlines-hidden", "-pthread"]
INSTRUCTION_SETS = {"base": []}
if platform.machine() in ("x86_64", "AMD64"):
    INSTRUCTION_SETS = {
        "base": ["-march=x86-64-v2"],
        "avx2": ["-march=x86-64-v3"],
        "avx512": ["-march=x86-64-v4", "-mprefer-vector-width=512"],
    }
KERNELS = {
    "decogs.decoder.rasterise._forward": ("decoder/rasterise/kernel", "forward.cpp"),
    "decogs.encoder.rasterise._training": ("encoder/rasterise/kernel", "training.cpp"),
    "decogs.encoder.transformation_cache._cache": ("encoder/transformation_cache/kernel", "cache.cpp"),
}


class BuildKernels(build_ext):
    """Gives every library an object folder of its own: several are built from one source."""

    def build_extension(self, ext: Extension) -> None:
        shared, self.build_temp = self.build_temp, str(Path(self.build_temp) / ext.name)
        try:
            super().build_extension(ext)
        finally:
            self.build_temp = shared


def kernels() -> list[Extension]:
    headers = [str(path) for folder, _ in KERNELS.values() for path in sorted(Path(folder).glob("*.h"))]
    return [
        Extension(
            f"{name}_{instruction_set}",
            [f"{folder}/{source}"],
            include_dirs=["decoder/rasterise/kernel", "encoder/rasterise/kernel"],
            depends=headers,
            extra_compile_args=[*COMMON_FLAGS, f"-Ddecogs=decogs_{instruction_set}", *flags],
            extra_link_args=["-pthread"],
            language="c++",
            py_limited_api=True,
        )
        for name, (folder, source) in KERNELS.items()
        for instruction_set, flags in INSTRUCTION_SETS.items()
    ]


setup(
    ext_modules=kernels(),
    cmdclass={"build_ext": BuildKernels},
    options={"bdist_wheel": {"py_limited_api": "cp310"}},
)
