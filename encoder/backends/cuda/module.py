"""The kernels of kernel/splatting.cu: compiled for the device at hand by torch's NVRTC, launched on its stream.

Chosen: ctypes on what torch brings, CUDA's driver and its run-time compiler. Rejected: CuPy's RawModule and cuda-core
(100 MB more, and a second owner of the device, for two functions), building at installation (it needs CUDA's toolkit).
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import torch
from torch import Tensor

import decogs.decoder.rasterise
from decogs.formats.errors import UsageError

THREADS = 256
"""Of a block (kernel/splatting.cu)."""
_LIBRARY = str(Path(torch.__file__).parent / "lib" / "libcaffe2_nvrtc.so")


class Kernels(Protocol):
    """The kernels by name."""

    def launch(self, name: str, blocks: tuple[int, ...], *arguments: Any) -> None:
        """Runs a kernel in so many blocks by axis. Its arguments are C's: tensors and None stand for pointers."""


@lru_cache(maxsize=1)
def kernel_source() -> str:
    """All of the source as one text, without the standard library."""
    here, shared = Path(__file__).parent, Path(decogs.decoder.rasterise.__file__).parent
    folders = [here / "kernel", here.parent / "cpu" / "kernel", shared / "kernel"]
    # One lane, in place of sixteen.
    seen = {"simd.h"}

    def text_of(name: str) -> str:
        if name in seen:
            return ""
        seen.add(name)
        path = next(path for folder in folders if (path := folder / name).exists())
        text = re.sub(r"^#pragma once$|^#include <.*>$", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
        return re.sub(r'^#include "(.*)"$', lambda include: text_of(include[1]), text, flags=re.MULTILINE)

    return text_of("lane.h") + text_of("splatting.cu")


def as_argument(value: Any) -> Any:
    """An argument as C has it; whole numbers are 64 bits wide."""
    if isinstance(value, Tensor):
        return ctypes.c_void_p(value.data_ptr())
    if value is None:
        return ctypes.c_void_p()
    if isinstance(value, int):
        return ctypes.c_int64(value)
    return ctypes.c_float(value) if isinstance(value, float) else value


class CompiledKernels:
    """``Kernels`` on a CUDA device. They are compiled on a thread of their own, until one is first needed."""

    def __init__(self, device: torch.device) -> None:
        self._device, self._library = device, _cuda_library()
        major, minor = torch.cuda.get_device_capability(device)
        maker = ThreadPoolExecutor(1)
        self._code = maker.submit(_compiled, self._library, f"sm_{major}{minor}")
        maker.shutdown(wait=False)
        self._functions: dict[str, Any] = {}
        self._module: Any = None

    def launch(self, name: str, blocks: tuple[int, ...], *arguments: Any) -> None:
        function = self._functions.get(name) or self._function(name)
        given = [as_argument(value) for value in arguments]
        pointers = (ctypes.c_void_p * len(given))(*map(ctypes.addressof, given))
        x, y, z = (*blocks, 1, 1)[:3]
        stream = ctypes.c_void_p(torch.cuda.current_stream(self._device).cuda_stream)
        _check(_launch()(function, x, y, z, THREADS, 1, 1, 0, stream, pointers, None), f"starting {name}")

    def _function(self, name: str) -> Any:
        if self._module is None:
            torch.empty(1, device=self._device)  # torch's context is this thread's from now on
            self._module = ctypes.c_void_p()
            _check(self._library.cuModuleLoadData(ctypes.byref(self._module), self._code.result()), "loading kernels")
        function, find = ctypes.c_void_p(), self._library.cuModuleGetFunction
        _check(find(ctypes.byref(function), self._module, name.encode()), f"finding {name}")
        self._functions[name] = function
        return function


@lru_cache(maxsize=1)
def _cuda_library() -> Any:
    """NVRTC and the driver: the library through which torch finds both has their functions, too."""
    return ctypes.CDLL(_LIBRARY)


@lru_cache(maxsize=1)
def _launch() -> Any:
    """The driver's function; other threads wait for the microseconds that it takes, and a step does not for them."""
    launch = ctypes.PyDLL(_LIBRARY).cuLaunchKernel
    launch.argtypes = [ctypes.c_void_p, *[ctypes.c_uint] * 7, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p]
    return launch


def _compiled(nvrtc: Any, architecture: str) -> bytes:
    """The device's code of all kernels."""
    program, options = ctypes.c_void_p(), [f"-arch={architecture}", "-std=c++17", "-default-device", "-lineinfo"]
    source, given = kernel_source().encode(), (ctypes.c_char_p * len(options))(*(text.encode() for text in options))
    _check(nvrtc.nvrtcCreateProgram(ctypes.byref(program), source, b"splatting.cu", 0, None, None), "compiling kernels")
    if nvrtc.nvrtcCompileProgram(program, len(options), given):
        log = _text_of(program, nvrtc.nvrtcGetProgramLogSize, nvrtc.nvrtcGetProgramLog)
        first = next(iter(log.decode(errors="replace").splitlines()), "")
        raise UsageError(f"`device` cuda: the compiler refuses the kernels for {architecture} ({first}); or use cpu")
    code = _text_of(program, nvrtc.nvrtcGetCUBINSize, nvrtc.nvrtcGetCUBIN)
    nvrtc.nvrtcDestroyProgram(ctypes.byref(program))
    return code


def _text_of(program: ctypes.c_void_p, size_of: Callable[..., int], write: Callable[..., int]) -> bytes:
    size = ctypes.c_size_t()
    _check(size_of(program, ctypes.byref(size)), "compiling kernels")
    text = ctypes.create_string_buffer(size.value)
    _check(write(program, text), "compiling kernels")
    return text.raw


def _check(status: int, what: str) -> None:
    """UsageError for a status of CUDA's that is not 0."""
    if status:
        raise UsageError(f"`device` cuda: CUDA's error {status} in {what}; try a newer driver or torch, or use cpu")
