"""The CUDA backend on a GPU and on the processor, and how near both must be to the native kernel.

On the processor an emulation of CUDA's threads (cuda_emulation.h) runs the same kernels, compiled as C++.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rasterise_cases as cases
from decogs.encoder.backends import Gradients
from decogs.encoder.backends.cuda.cuda_kernel import CudaKernel
from decogs.encoder.backends.cuda.module import THREADS, as_argument, kernel_source
from decogs.encoder.settings.optimiser import LearningRates
from decogs.formats.splats import Splats

RATES = LearningRates(0.01, 0.01, 0.01, 0.01, 0.01, 0.01)
FIELDS = ("means", "log_scales", "quaternions", "opacity_logits", "sh", "view")
CAMERA = cases.pinhole(83, 61, 70.0)
THRESHOLD = 1 / 255
"""Where alpha is at the threshold, rounding decides whether a contribution of this size is drawn."""
EMULATION = Path(__file__).with_name("cuda_emulation.h")
BUILT = Path(__file__).parents[1] / "build" / "emulation"


def emulated_source() -> str:
    """The kernels as C++, and a function that runs one of them by name."""
    source = kernel_source()
    names = re.findall(r"__global__ void (?:__launch_bounds__\(kThreads\)\s*)?(\w+)\(", source)
    calls = "".join(f'if (wanted == "{each}") return launch(decogs::{each}, x, y, z, n, given), 0;\n' for each in names)
    signature = "int emulate(const char* name, unsigned x, unsigned y, unsigned z, unsigned n, void** given)"
    run = f'extern "C" {signature} {{ using emulation::launch;\nconst std::string wanted(name);\n{calls}return 1; }}\n'
    return EMULATION.read_text() + source + run


@lru_cache(maxsize=1)
def emulation() -> ctypes.CDLL:
    """Compiled once for these sources; skips the test where there is no g++."""
    compiler, source = os.environ.get("CXX") or shutil.which("g++"), emulated_source()
    if not compiler:
        pytest.skip("no C++ compiler for the emulation of CUDA")
    library = BUILT / f"{hashlib.sha256(source.encode()).hexdigest()[:16]}.so"
    if not library.exists():
        BUILT.mkdir(parents=True, exist_ok=True)
        growing = library.with_suffix(f".{os.getpid()}")
        command = [compiler, "-std=c++17", "-O2", "-shared", "-fPIC", "-ffp-contract=off", "-w", "-x", "c++", "-"]
        subprocess.run([*command, "-o", str(growing)], input=source.encode(), check=True)
        growing.replace(library)
    return ctypes.CDLL(str(library))


class EmulatedKernels:
    """``Kernels`` on the processor, whose threads come in their order or ``backwards``."""

    def __init__(self, *, backwards: bool = False) -> None:
        self._library, self._backwards = emulation(), backwards

    def launch(self, name: str, blocks: tuple[int, ...], *arguments: Any) -> None:
        given = [as_argument(value) for value in arguments]
        pointers = (ctypes.c_void_p * len(given))(*map(ctypes.addressof, given))
        ctypes.c_int.in_dll(self._library, "decogs_backwards").value = self._backwards
        assert not self._library.emulate(name.encode(), *(*blocks, 1, 1)[:3], THREADS, pointers), name


def emulated_kernel(*, backwards: bool = False) -> CudaKernel:
    return CudaKernel(device="cpu", kernels=EmulatedKernels(backwards=backwards))


@dataclass(frozen=True)
class Backend:
    """A kernel under test and how far it may be from the native one.

    ``picture``: of a pixel, relative to the largest value. ``gradient``: of an attribute's gradients, length of the
    difference relative to their own length.
    """

    make: Callable[[], CudaKernel]
    picture: float
    gradient: float


BACKENDS = {
    # The native kernel's operations, but for exponentials, logarithms and the order of sums over a tile.
    "emulated": Backend(emulated_kernel, 1e-5, 3e-5),
    # Multiplications and additions are contracted there.
    "gpu": Backend(CudaKernel, 2e-5, 1e-4),
}


def small_scene(seed: int, count: int = 120, degree: int = 1) -> Splats:
    scene: Splats = cases.scene(seed, count, degree, sigma=(0.02, 0.08))
    return scene


def assert_same_picture(actual: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    """Up to ``tolerance``; two pixels in a thousand may have a Gaussian more or less at the threshold of alpha."""
    largest = max(1.0, float(np.abs(expected).max()))
    off = np.abs(actual - expected)
    assert off.shape == expected.shape
    assert off.max() <= 1.1 * THRESHOLD * largest
    assert (off > tolerance * largest).mean() <= 0.002


def assert_same_gradients(given: Gradients, wanted_ones: Gradients, tolerance: float) -> None:
    actual, expected = given.host(), wanted_ones.host()
    for name in FIELDS:
        found, wanted = getattr(actual, name), getattr(expected, name)
        assert np.isfinite(found).all(), name
        assert np.linalg.norm(found - wanted) <= tolerance * np.linalg.norm(wanted), name
        assert (found[(expected.view == 0) & (actual.view == 0)] == 0).all(), name
