"""Checks the libraries of wheels, whatever platform they are for: ``python release/check.py WHEEL ...``.

What auditwheel, delvewheel and delocate ask, each on its own system, asked here of all: that a library is of the
wheel's processor and system, needs no other libraries than every such system has, in no newer version than the wheel
says, and offers the loader the functions that it asks for. LIEF reads ELF, PE and Mach-O alike.
"""

from __future__ import annotations

import re
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

import lief

lief.logging.disable()
ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from setup import KERNELS, TARGETS, X86_SETS  # noqa: E402

ELF_LIBRARIES = {"libc.so.6", "libm.so.6", "libpthread.so.0", "libdl.so.2", "librt.so.1"} | {
    "ld-linux-x86-64.so.2",
    "ld-linux-aarch64.so.1",
}
"""Source: PEP 599, the list of libraries, as far as C needs them."""
DLLS = re.compile(r"(KERNEL32|ntdll|api-ms-win-crt-[a-z]+-l1-1-0)\.dll", re.IGNORECASE)
"""Those of Windows 10, which has the C library."""
DYLIBS = {"/usr/lib/libSystem.B.dylib"}
ASKED = {"_ycbcr": "decogs_rgb_of_ycbcr", "_forward": "decogs_render", "_training": "decogs_backward"}
ASKED |= {"_cache": "decogs_cache_step"}


def complaints(wheel: Path) -> Iterator[str]:
    """What is wrong with the wheel, a sentence each."""
    tag = wheel.stem.split("-")[-1]
    (platform,) = (name for name, target in TARGETS.items() if target.tag == tag)
    target = TARGETS[platform]
    sets = X86_SETS if platform.endswith("x86_64") else ("base",)
    expected = {f"{name.replace('.', '/')}_{kind}{target.suffix}" for name in KERNELS for kind in sets}
    with zipfile.ZipFile(wheel) as archive:
        libraries = {name for name in archive.namelist() if re.search(r"\.(so|pyd|dll|dylib)$", name)}
        for name in sorted(expected ^ libraries):
            yield f"{name}: is {'missing' if name in expected else 'not expected'}"
        for name in sorted(expected & libraries):
            yield from (f"{name}: {what}" for what in wrong_with(archive.read(name), name, platform))


def wrong_with(data: bytes, name: str, platform: str) -> Iterator[str]:
    """What is wrong with a library of that platform."""
    library = lief.parse(list(data))
    look = {"linux": _elf, "windows": _pe, "macos": _mach_o}[platform.split("-")[0]]
    processor = platform.split("-")[1].replace("arm64", "aarch64")
    yield from look(library, processor)
    offered = {str(function.name).removeprefix("_") for function in library.exported_functions}
    wanted = ASKED[PurePosixPath(name).name.split(".")[0].rpartition("_")[0]]
    if not {wanted, "decogs_sizes"} <= offered:
        yield f"offers no {wanted}"


def _elf(library: lief.ELF.Binary, processor: str) -> Iterator[str]:
    if library.header.machine_type.name != processor.upper():
        yield f"is for {library.header.machine_type.name}"
    if strange := set(library.libraries) - ELF_LIBRARIES:
        yield f"needs {', '.join(sorted(map(str, strange)))}"
    versions = {v.name for needed in library.symbols_version_requirement for v in needed.get_auxiliary_symbols()}
    numbers = {tuple(map(int, v.removeprefix("GLIBC_").split("."))) for v in versions if v.startswith("GLIBC_")}
    if max(numbers, default=(0,)) > (2, 17):
        yield f"needs glibc {'.'.join(map(str, max(numbers)))}, and the wheel says 2.17"
    offered = [str(function.name) for function in library.exported_functions]
    if foreign := [name for name in offered if not name.startswith(("decogs_", "_Z"))]:
        yield f"offers {', '.join(foreign)}, too, which others could take for theirs"
    if any(segment.type.name == "GNU_STACK" and segment.has(lief.ELF.Segment.FLAGS.X) for segment in library.segments):
        yield "asks for a stack that can be executed"


def _pe(library: lief.PE.Binary, processor: str) -> Iterator[str]:
    if (library.header.machine.name, processor) != ("AMD64", "x86_64"):
        yield f"is for {library.header.machine.name}"
    if strange := [str(name) for name in library.libraries if not DLLS.fullmatch(str(name))]:
        yield f"needs {', '.join(strange)}"


def _mach_o(library: lief.MachO.Binary, processor: str) -> Iterator[str]:
    expected = {"x86_64": "X86_64", "aarch64": "ARM64"}[processor]
    if library.header.cpu_type.name != expected:
        yield f"is for {library.header.cpu_type.name}"
    needed = {str(each.name) for each in library.libraries if each.command.name != "ID_DYLIB"}
    if strange := needed - DYLIBS:
        yield f"needs {', '.join(sorted(strange))}"
    oldest = library.build_version.minos if library.build_version else library.version_min.version
    if list(oldest)[:2] != [11, 0]:
        yield f"needs macOS {oldest}, and the wheel says 11.0"
    if processor == "aarch64" and not library.has_code_signature:
        yield "is not signed, without which Apple's processors load nothing"


def main(wheels: list[str]) -> int:
    """Prints a line a wheel, and what is wrong; 1 when anything is."""
    found = 0
    for wheel in map(Path, wheels):
        with zipfile.ZipFile(wheel) as archive:
            unpacked = sum(member.file_size for member in archive.infolist())
            native = sum(m.file_size for m in archive.infolist() if m.filename.endswith((".so", ".pyd")))
        wrong = list(complaints(wheel))
        found += len(wrong)
        sizes = f"{wheel.stat().st_size / 1e6:.1f} MB, unpacked {unpacked / 1e6:.1f}, of it kernels {native / 1e6:.1f}"
        print(f"{wheel.name}: {sizes}{'' if wrong else ': good'}")
        for line in wrong:
            print(f"  {line}")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
