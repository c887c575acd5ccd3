"""Builds the sdist, and from it a wheel for every platform: ``python release/wheels.py FOLDER [PLATFORM ...]``.

Zig compiles for all of them on one machine. The same sources make the same bytes: times are that of the last commit, or
SOURCE_DATE_EPOCH, and the owners of files nobody's. Needs what `make wheels` installs: build, setuptools and ziglang.
"""

from __future__ import annotations

import gzip
import io
import os
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from setup import TARGETS  # noqa: E402


def commit_time() -> str:
    """Seconds since 1970 at which the sources were committed."""
    told = ["git", "-C", str(ROOT), "log", "-1", "--format=%ct"]
    return (
        os.environ.get("SOURCE_DATE_EPOCH")
        or subprocess.run(told, check=True, capture_output=True, text=True).stdout.strip()
    )


def build_sdist(folder: Path, time: str) -> Path:
    """The sdist of the checkout, in ``folder``."""
    with tempfile.TemporaryDirectory() as made:
        _build("--sdist", ROOT, Path(made))
        (packed,) = Path(made).iterdir()
        sdist = folder / packed.name
        sdist.write_bytes(nobodys(packed.read_bytes(), int(time)))
    return sdist


def nobodys(archive: bytes, time: int) -> bytes:
    """The same .tar.gz without what depends on who packed it, where and when."""
    packed = io.BytesIO()
    with (
        tarfile.open(fileobj=io.BytesIO(archive)) as source,
        gzip.GzipFile(fileobj=packed, mode="wb", filename="", mtime=time) as deflated,
        tarfile.open(fileobj=deflated, mode="w", format=tarfile.PAX_FORMAT) as target,
    ):
        for member in sorted(source.getmembers(), key=lambda member: member.name):
            member.uid, member.gid, member.uname, member.gname, member.mtime = 0, 0, "", "", time
            member.mode, member.pax_headers = 0o755 if member.isdir() or member.mode & 0o100 else 0o644, {}
            target.addfile(member, source.extractfile(member) if member.isfile() else None)
    return packed.getvalue()


def build_wheel(sdist: Path, platform: str, folder: Path, time: str) -> None:
    """The wheel of a platform, a name of setup.py's TARGETS, in ``folder``."""
    with tempfile.TemporaryDirectory() as unpacked:
        with tarfile.open(sdist) as archive:
            archive.extractall(unpacked, filter="data")
        (sources,) = Path(unpacked).iterdir()
        _build("--wheel", sources, folder, DECOGS_TARGET=platform, SOURCE_DATE_EPOCH=time)


def _build(what: str, sources: Path, folder: Path, **environment: str) -> None:
    command = [sys.executable, "-m", "build", what, "--no-isolation", "--outdir", str(folder), str(sources)]
    built = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=False)
    if built.returncode:
        sys.exit(f"{built.stdout}{built.stderr}release/wheels.py: {what[2:]} was not built; what stands above says why")


def build_all(folder: Path, platforms: list[str]) -> list[Path]:
    """The sdist and the wheels in ``folder``, which is made."""
    unknown = sorted(set(platforms) - set(TARGETS))
    if unknown:
        sys.exit(f"release/wheels.py: {unknown[0]} is no platform of setup.py; choose from {', '.join(TARGETS)}")
    os.umask(0o022)  # The modes of files are in the archives, too.
    folder.mkdir(parents=True, exist_ok=True)
    time = commit_time()
    sdist = build_sdist(folder, time)
    for platform in platforms or TARGETS:
        print(f"{platform} ...", flush=True)
        build_wheel(sdist, platform, folder, time)
    return sorted(folder.iterdir())


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit("usage: python release/wheels.py FOLDER [PLATFORM ...]")
    build_all(Path(sys.argv[1]).resolve(), sys.argv[2:])
