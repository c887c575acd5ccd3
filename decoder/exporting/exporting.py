"""Exports frames of a stream: as one USD file, or as files of Gaussians, one a frame; the output's name decides.

What is common to both is here: which frames, how they are numbered, and which way is up. USD itself is ``usd_export``
and ``decogs.formats.usd.writing``; formats of Gaussians are ``decogs.formats.splat_files``.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.formats.errors import UsageError
from decogs.formats.files.outputs import Output, check_outputs, errors_named, files_read, staged_files
from decogs.formats.files.regular_files import open_regular
from decogs.formats.frames.names import is_numbered, names_of_frames
from decogs.formats.frames.ranges import Frames
from decogs.formats.geometry.length_units import metres_of
from decogs.formats.geometry.similarity import Similarity, transformed_splats
from decogs.formats.geometry.up_direction import AXES, UPS, Up, Vector, turn_between, up_text, up_vector
from decogs.formats.splat_files import Extremes, SplatFormat, splat_formats
from decogs.formats.splat_files.spz import Spz, SpzVersion
from decogs.formats.splats import Splats
from decogs.formats.system.callbacks import OnProgress, OnWarning
from decogs.formats.usd.openusd import load_openusd
from decogs.formats.usd.prims import FLAVOURS, Flavour
from decogs.formats.usd.writing import USD_SUFFIXES

from ..frame_choice import open_chosen
from ..limits import DEFAULT_MAX_MEMORY
from ..output.pictures import DEFAULT_FPS
from .safe_orbit import safe_orbit

if TYPE_CHECKING:
    from ..subject.subject import AnyStream

_LAST_NUMBER = 2**31 - 1
_CHUNK = 1 << 20
_VERSION_DIGITS = 12


@dataclass(frozen=True)
class ExportReport:
    """What an export wrote: frames, files and their bytes together.

    ``up``: the world's up, as an axis or three components, and ``up_in_file`` what it was turned to; None where nothing
    was. ``metres``: what a world unit became. ``static_count``, ``dynamic_count``: Gaussians that never and that ever
    change, which only USD separates.
    """

    frame_count: int
    file_count: int
    file_bytes: int
    up: str | None
    up_in_file: str
    metres: float
    static_count: int | None = None
    dynamic_count: int | None = None


@dataclass(frozen=True)
class _Plan:
    """What is asked for beside the frames."""

    output: Path | BinaryIO
    suffix: str
    up: Up
    first_frame: int
    fps: float | None
    scale: float | None
    spz_version: SpzVersion | None
    prim: Flavour
    velocities: bool
    on_frame: OnProgress | None
    on_warning: OnWarning | None


def export(
    stream: str | os.PathLike[str],
    output: str | os.PathLike[str] | BinaryIO,
    *,
    frames: Frames = None,
    up: Up = "auto",
    first_frame: int = 0,
    fps: float | None = None,
    scale_to_metres: float | None = None,
    format: str | None = None,
    spz_version: SpzVersion | None = None,
    prim: Flavour | None = None,
    velocities: bool = False,
    subject: str | os.PathLike[str] | None = None,
    strict: bool = False,
    max_memory: int = DEFAULT_MAX_MEMORY,
    layer: str | int | None = None,
    on_frame: OnProgress | None = None,
    on_warning: OnWarning | None = None,
) -> ExportReport:
    """Writes frames: one USD file (.usdc, .usda, .usd, .usdz), or Gaussians (.ply, .spz, .sog, .splat, .glb).

    ``output``: the file's name, whose ending chooses what is written and which ``decogs.formats.frames.names`` numbers;
    or an open file for what ``format`` names, such as "ply". ``frames``: consecutive ones, as a slice or a range; None
    for all. ``up``: the world's up, which is turned to what the format has for it (``geometry.up_direction``).
    ``first_frame``: the number of the stream's frame 0, in names and as USD's time code. ``fps``: the stream's by
    default. ``scale_to_metres``: metres of a world unit; positions and sizes are multiplied by it; by default as the
    rig states its unit, or 1. ``spz_version``: 2,
    3 or 4. ``prim``: how USD shows Gaussians: "instancer" (default), "splat" or
    "both". ``velocities``: USD's instancers get them, in world units a second, for programs that blur by them.
    ``subject``: a folder of mattes; only Gaussians in their hull are written (``decogs.decoder.subject.subject``).
    ``strict``, ``max_memory`` (bytes) and ``layer`` are those of ``open_stream``. The frames are read twice, and
    ``on_frame(done, all)`` counts both readings; ``on_warning(text)`` is called for damage and for losses of the
    format.

    Raises UsageError, StreamError or OSError; no file is then left or replaced.
    """
    target = Path(output) if isinstance(output, (str, os.PathLike)) else output
    suffix = _suffix(target, format)
    if up not in UPS:
        raise UsageError(f"`up` {up}: no such direction; choose from {', '.join(UPS)}")
    if scale_to_metres is not None and not (np.isfinite(scale_to_metres) and scale_to_metres > 0):
        raise UsageError(f"`scale_to_metres` {scale_to_metres:g}: give the metres of a world unit, a positive number")
    if fps is not None and not (np.isfinite(fps) and fps > 0):
        raise UsageError(f"`fps` {fps:g}: give a positive number of frames per second")
    if spz_version is not None and suffix != ".spz":
        raise UsageError(f"`spz_version` {spz_version}: the output is a {suffix}; name a .spz, or leave it out")
    if prim is not None and suffix not in USD_SUFFIXES:
        raise UsageError(f"`prim` {prim}: the output is a {suffix}; name a .usdc, or leave it out")
    if prim is not None and prim not in FLAVOURS:
        raise UsageError(f"`prim` {prim}: no such kind of prim; choose from {', '.join(FLAVOURS)}")
    flavour: Flavour = prim or "instancer"
    if velocities and (suffix not in USD_SUFFIXES or flavour == "splat"):
        held = "splat prims have" if suffix in USD_SUFFIXES else f"a {suffix} has"
        raise UsageError(f"`velocities`: {held} no place for them; write USD with instancers, or leave it out")
    plan = _Plan(
        target, suffix, up, first_frame, fps, scale_to_metres, spz_version, flavour, velocities, on_frame, on_warning
    )
    with open_chosen(stream, frames, strict=strict, max_memory=max_memory, on_warning=on_warning, layer=layer) as (
        opened,
        chosen,
    ):
        if not 0 <= first_frame <= _LAST_NUMBER - chosen.stop:
            raise UsageError(f"`first_frame` {first_frame}: give a number from 0 on")
        numbers = [first_frame + frame for frame in chosen]
        names = _names(target, suffix, numbers)
        outputs = [Output("output", name) for name in names] or [Output("output", target)]
        shown: AnyStream = opened
        read = files_read(stream=stream)
        if subject is not None:
            from ..subject.subject import SubjectOfStream

            shown = SubjectOfStream(opened, Path(subject), chosen, on_warning)
            read += shown.files_read()
        check_outputs(outputs, read)
        if suffix in USD_SUFFIXES:
            return _export_usd(plan, shown, chosen, Path(stream))
        return _export_splats(plan, shown, chosen, names)


def _write_all(file: BinaryIO, data: bytes) -> None:
    """A pipe that is not buffered may take a part, the last one before its reader is gone."""
    left = memoryview(data)
    with errors_named("standard output"):
        while left:
            left = left[file.write(left) :]


def _flush(file: BinaryIO) -> None:
    with errors_named("standard output"):
        file.flush()


def _suffix(target: Path | BinaryIO, format: str | None) -> str:
    """Which kind of file is asked for, as a name's ending."""
    kinds = [*USD_SUFFIXES, *splat_formats()]
    suffixes = ", ".join(kinds)
    if isinstance(target, Path):
        if format is not None:
            raise UsageError(f"`format` {format}: the name {target} has an ending that says it; leave `format` out")
        if target.suffix.lower() not in kinds:
            raise UsageError(f"{target}: exports are {suffixes}; choose one of these endings")
        return target.suffix.lower()
    if format is None:
        raise UsageError(f"-: a pipe has no name; say by `format` which of {suffixes} goes into it")
    suffix = f".{format.lower().lstrip('.')}"
    if suffix not in kinds:
        raise UsageError(f"`format` {format}: exports are {suffixes}; choose one of these")
    return suffix


def _names(target: Path | BinaryIO, suffix: str, numbers: list[int]) -> list[Path]:
    """Every file that is to be written; none for a pipe."""
    if suffix in USD_SUFFIXES:
        if isinstance(target, Path) and is_numbered(target):
            raise UsageError(f"{target}: one USD file holds all frames; name it without a place for their number")
        return [target] if isinstance(target, Path) else []
    if isinstance(target, Path):
        if target.is_dir():
            raise UsageError(f"{target}: is a folder; name files in it, such as {target / f'x_####{suffix}'}")
        name = names_of_frames(target, len(numbers))
        names = [target.with_name(name(number)) for number in numbers]
        folder = next((path for path in names if path.is_dir()), None)
        if folder is not None:
            raise UsageError(f"{folder}: is a folder; choose another name")
        return names
    if len(numbers) > 1:
        raise UsageError(f"-: {len(numbers)} frames are as many {suffix} files; choose one of the `frames`, or a name")
    return []


def _similarity(plan: _Plan, header: StreamHeader, to: str) -> tuple[Similarity, Vector | None]:
    """What brings the world to a format's up and to metres, and the world's up; None where it is not to be turned."""
    up = up_vector(plan.up, header.cameras)
    rotation = np.eye(3) if up is None else turn_between(up, AXES[to])
    return Similarity(rotation, _metres(plan, header)), up


def _metres(plan: _Plan, header: StreamHeader) -> float:
    """Of a world unit: what was asked for, else what the rig states, else 1."""
    return plan.scale if plan.scale is not None else metres_of(header.units) or 1.0


def _asset(source: Path) -> tuple[str, str]:
    """Name and version of what a stream shows: its file's name, and the beginning of its bytes' SHA-256.

    The same stream is the same version, and one that was encoded again is another.
    """
    digest = hashlib.sha256()
    with open_regular(source) as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
    # A name need not be text that USD can hold.
    return source.stem.encode("utf-8", "replace").decode(), digest.hexdigest()[:_VERSION_DIGITS]


def _documentation(header: StreamHeader, name: str) -> str:
    """What the footage is and who may use it, as the stream says; or at least what this file is."""
    facts = " ".join(text for text in (header.source_text, header.licence) if text)
    own = f"{name}: free-viewpoint video as 3D Gaussians, from {len(header.cameras)} cameras, by {header.writer}."
    return f"{own} {facts}" if facts else own


def _export_usd(plan: _Plan, stream: AnyStream, chosen: range, source: Path) -> ExportReport:
    from .usd import ExportFrame, export_usd

    load_openusd()  # Before all frames are read for nothing, where it is not installed.
    header, done = stream.header, 0
    root, up = _similarity(plan, header, "Y")
    asset = _asset(source)

    def read_again() -> Iterator[ExportFrame]:
        nonlocal done
        for frame in stream.frames(chosen.start, chosen.stop):
            yield ExportFrame(plan.first_frame + frame.index, frame.state.ids, frame.splats)
            done += 1
            if plan.on_frame is not None:
                plan.on_frame(done, 2 * len(chosen))

    def write(path: Path) -> ExportReport:
        report = export_usd(
            read_again,
            path,
            fps=plan.fps or header.fps or DEFAULT_FPS,
            cameras=header.cameras,
            root=root,
            flavour=plan.prim,
            asset=asset,
            velocities=plan.velocities,
            documentation=_documentation(header, asset[0]),
        )
        return ExportReport(
            report.frame_count,
            1,
            report.file_bytes,
            None if up is None else up_text(up),
            "Y",
            root.scale,
            report.static_count,
            report.dynamic_count,
        )

    if isinstance(plan.output, Path):
        return write(plan.output)
    # OpenUSD writes to names only.
    with tempfile.TemporaryDirectory(prefix="decogs-") as folder:
        path = Path(folder) / f"scene{plan.suffix}"
        report = write(path)
        with path.open("rb") as file:
            while chunk := file.read(_CHUNK):
                _write_all(plan.output, chunk)
    _flush(plan.output)
    return report


def _export_splats(plan: _Plan, stream: AnyStream, chosen: range, names: list[Path]) -> ExportReport:
    form = splat_formats()[plan.suffix](compensated=True)
    similarity, up = _similarity(plan, stream.header, form.up)
    if isinstance(form, Spz):
        form = replace(
            form, version=plan.spz_version or form.version, orbit=safe_orbit(stream.header.cameras, similarity)
        )
    form = _fitted(form, plan, _extremes(plan, stream, chosen, similarity, form))
    size = 0
    files = _files(form, plan, stream, chosen, similarity)
    if not isinstance(plan.output, Path):
        for data in files:
            size += len(data)
            _write_all(plan.output, data)
        _flush(plan.output)
    else:
        with staged_files(plan.output.parent) as staging:
            for name, data in zip(names, files, strict=True):
                with errors_named(str(name)):
                    size += (staging / name.name).write_bytes(data)
    up_line = None if up is None else up_text(up)
    return ExportReport(len(chosen), len(chosen), size, up_line, form.up, similarity.scale)


def _fitted(form: SplatFormat, plan: _Plan, extremes: Extremes) -> SplatFormat:
    """The format set to what the frames need; warns of what it leaves out. Raises UsageError where it cannot."""
    where = plan.output if isinstance(plan.output, Path) else "-"
    try:
        form, left_out = form.fitted(extremes)
    except UsageError as error:
        raise UsageError(f"{where}: {error}") from None
    if plan.on_warning is not None:
        for text in left_out:
            plan.on_warning(f"{where}: {text}")
    return form


def _extremes(plan: _Plan, stream: AnyStream, chosen: range, similarity: Similarity, form: SplatFormat) -> Extremes:
    """First reading: what the format has to hold. Raises UsageError for a value that is not finite."""
    extremes, before = Extremes(2**63, 0, 0.0, stream.header.sh_degree), None
    for done, frame in enumerate(stream.frames(chosen.start, chosen.stop), start=1):
        if frame.splats is not before:
            extremes = _with(extremes, transformed_splats(frame.splats, similarity), frame.index, form)
            before = frame.splats
        if plan.on_frame is not None:
            plan.on_frame(done, 2 * len(chosen))
    return extremes


def _with(extremes: Extremes, splats: Splats, frame: int, form: SplatFormat) -> Extremes:
    least, most = form.log_scales
    outside = (splats.log_scales < least) | (splats.log_scales > most)
    for name, values in vars(splats).items():
        if not np.isfinite(values).all():
            raise UsageError(f"frame {frame}: {name} of a Gaussian are not finite; choose another `scale_to_metres`")
    return Extremes(
        min(extremes.smallest, len(splats)),
        max(extremes.largest, len(splats)),
        max(extremes.farthest, float(np.abs(splats.means).max(initial=0))),
        extremes.sh_degree,
        max(extremes.clamped, int(outside.any(axis=1).sum())),
    )


def _files(form: SplatFormat, plan: _Plan, stream: AnyStream, chosen: range, similarity: Similarity) -> Iterator[bytes]:
    """Second reading: each frame's file; frames that show the same share it."""
    before, data = None, b""
    for done, frame in enumerate(stream.frames(chosen.start, chosen.stop), start=1):
        if frame.splats is not before:
            before, data = frame.splats, form.encode(transformed_splats(frame.splats, similarity))
        yield data
        if plan.on_frame is not None:
            plan.on_frame(len(chosen) + done, 2 * len(chosen))
