"""What no call from Python may do to the process: end it, hang it, or read what is not there."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from zstandard import backend_c

import rasterise_cases as cases
from decogs.decoder.rasterise import native, render
from decogs.decoder.rasterise.incremental_view import IncrementalView
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.backends.cpu.fixed_view import CpuFixedView
from decogs.formats.errors import UsageError
from decogs.formats.splats import take_splats
from decogs.formats.system.kernels import best_instruction_set, kernel_path, load_kernel

CASE = cases.CASES["17x13"]()
SCENE, CAMERA = take_splats(CASE.splats, np.arange(6)), CASE.camera
KEPT = np.arange(6)


def rows(*numbers: int) -> np.ndarray:
    return np.array(numbers, np.int64)


def changed(renumbered: np.ndarray | None, population: int, *, detached: np.ndarray) -> None:
    view = IncrementalView(CAMERA, (0, 0, 0), threads=1)
    view.set_scene(SCENE)
    view.change(detached, take_splats(SCENE, detached[:0]), detached[:0], population=population, renumbered=renumbered)
    view.redraw()


def committed(renumbered: np.ndarray | None, population: int, *, detached: np.ndarray) -> None:
    view = CpuFixedView(CpuKernel(1), CAMERA)
    view.set_scene(SCENE)
    view.detach(detached[:1])
    view.detach(detached[1:])
    view.commit(take_splats(SCENE, np.arange(population) % 6), detached[:0], renumbered)
    view.redraw()


@pytest.mark.parametrize("change", [changed, committed])
@pytest.mark.parametrize(
    ("renumbered", "population"),
    [
        (rows(-1, -1, -1, -1, -1, -1), 0),
        (rows(5, 4, 3, 2, 1, 0), 6),
        (rows(0, 0, 1, 2, 3, 4), 6),
        (rows(0, -1, 2, -1, 5, 6), 7),
        (rows(0, -1, 1, -1, 2, 3), 3),
        (rows(0, -1, 1, -2, 2, 3), 6),
        (rows(0, -1, 1), 6),
        (rows(0, -1, 1, -1, 2, 3).astype(np.int32), 6),
        (None, 5),
    ],
    ids=["not detached", "turned round", "twice", "moved up", "outside", "below -1", "too few", "int32", "none"],
)
def test_new_numbers_that_the_kernel_cannot_use_are_refused(
    change: Callable[..., None], renumbered: np.ndarray | None, population: int
) -> None:
    with pytest.raises(ValueError, match=r"number|-1"):
        change(renumbered, population, detached=rows(1, 3))
    change(rows(0, -1, 1, -1, 2, 3), 4, detached=rows(1, 3))
    change(None, 6, detached=rows(1, 3))


def test_rows_outside_the_scene_are_refused() -> None:
    view = CpuFixedView(CpuKernel(1), CAMERA)
    view.set_scene(SCENE)
    with pytest.raises(ValueError, match="rows must ascend"):
        view.draw(take_splats(SCENE, rows(0)), rows(1 << 40))
    kernel = CpuKernel(1)
    with pytest.raises(ValueError, match="last forward"):
        kernel.centres(6)
    kernel.forward(SCENE, CAMERA)
    with pytest.raises(ValueError, match="last forward"):
        kernel.centres(7)


SHORT_OF_MEMORY = """
import resource, sys
import numpy as np
from decogs.decoder.rasterise import render
from decogs.decoder.rasterise.native import render_planes
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.formats.cameras import Camera
from decogs.formats.splats import Splats

def covering(count):
    values = (np.tile([0, 0, 2.0], (count, 1)), np.ones((count, 3)), np.tile([1.0, 0, 0, 0], (count, 1)),
              np.full(count, 5.0), np.zeros((count, 1, 3)))
    return Splats(*(np.ascontiguousarray(value, np.float32) for value in values))

camera = Camera("a", 512, 512, 512.0, 512.0, 256.0, 256.0, np.eye(4))
kernel = CpuKernel(2)
draw = {"render": lambda scene: render(scene, camera, threads=2), "train": lambda scene: kernel.forward(scene, camera)}
few, many = covering(8), covering(60_000)
before = draw[sys.argv[1]](few)
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
_, most = resource.getrlimit(resource.RLIMIT_AS)
resource.setrlimit(resource.RLIMIT_AS, (used + (128 << 20), most))
try:
    draw[sys.argv[1]](many)
except MemoryError as error:
    print("out of memory:", error)
resource.setrlimit(resource.RLIMIT_AS, (most, most))
after = draw[sys.argv[1]](few)
print("as before:", all((x is None and y is None) or (x == y).all() for x, y in
      zip(vars(before).values(), vars(after).values())))
"""


@pytest.mark.parametrize("what", ["render", "train"])
def test_memory_that_runs_out_on_the_pools_threads_is_an_exception(what: str) -> None:
    """61 million pairs of a tile and a Gaussian want 0.25 GB before their number is known, with 0.13 GB to be had."""
    run = subprocess.run([sys.executable, "-c", SHORT_OF_MEMORY, what], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stderr) == (0, "")
    assert run.stdout.startswith("out of memory: ")
    assert run.stdout.endswith("as before: True\n")


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_a_forked_child_renders_and_trains() -> None:
    """The threads of the parent's pools do not exist there."""
    camera, kernel = cases.pinhole(45, 37, 40.0), CpuKernel(2)  # three rows of tiles: work for two threads
    expected, picture = render(SCENE, camera, threads=2).image, kernel.forward(SCENE, camera).rgb
    with native.renderer(2)._lock:  # as if another thread were in the midst of a picture
        child = os.fork()
        if not child:
            try:
                same = np.array_equal(render(SCENE, camera, threads=2).image, expected)
                same &= np.array_equal(kernel.forward(SCENE, camera).rgb, picture)
                del kernel
            finally:
                os._exit(0 if same else 1)
    for _ in range(600):
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            assert status == 0
            break
        time.sleep(0.1)
    else:
        os.kill(child, 9)
        os.waitpid(child, 0)
        pytest.fail("the child hangs")
    np.testing.assert_array_equal(render(SCENE, camera, threads=2).image, expected)


def test_a_missing_kernel_is_said_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="the compiled kernel is missing"):
        load_kernel(tmp_path, "_forward", [])
    shutil.copy(native.__file__, tmp_path / "native.py")
    program = f"""
import importlib.util
spec = importlib.util.spec_from_file_location("alone", {str(tmp_path / "native.py")!r})
alone = importlib.util.module_from_spec(spec)
spec.loader.exec_module(alone)
try:
    alone.Renderer(1)
except Exception as error:
    print(type(error).__name__, error)
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert run.stdout.startswith("UsageError ")
    assert "_forward_" in run.stdout
    assert run.stderr == "", "nothing of a renderer that never came to be"


def test_a_kernel_that_cannot_be_loaded_is_said_in_one_line(tmp_path: Path) -> None:
    """As where an environment was copied from a machine of another kind, or lies where nothing may be run."""
    path = kernel_path(tmp_path, "_forward", best_instruction_set())
    path.write_bytes(b"no library")
    with pytest.raises(UsageError) as caught:
        load_kernel(tmp_path, "_forward", [])
    assert str(caught.value).startswith(f"{path}: the compiled kernel cannot be loaded (")
    assert str(caught.value).count(str(path)) == 1
    assert str(caught.value).endswith("); install decogs again (in a checkout: make)")


def test_a_kernel_of_other_sources_is_refused(tmp_path: Path) -> None:
    """A struct more, one less, a longer one, two changed about, and a library from before sizes were compared."""
    package, set_ = Path(native.__file__).parent, best_instruction_set()
    structs = [native.NativeScene, native.NativeCamera, native.NativePlanes, native.NativePicture]
    load_kernel(package, "_forward", structs)

    class Longer(native.NativePicture):
        _fields_ = (("more", ctypes.c_void_p),)

    for wrong in (structs[:-1], [*structs, Longer], [*structs[:-1], Longer], structs[::-1], []):
        with pytest.raises(UsageError, match=r"_forward_\w+\.abi3\.so: the compiled kernel is of another version"):
            load_kernel(package, "_forward", wrong)
    shutil.copy(backend_c.__file__, kernel_path(tmp_path, "_forward", set_))
    with pytest.raises(UsageError, match="the compiled kernel is of another version"):
        load_kernel(tmp_path, "_forward", structs)
