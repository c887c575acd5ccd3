"""A take encoded on a cluster: the first keyframe, then the parts side by side, then all of them joined.

Parts that are done lie in ``SCENE.DGS.parts`` beside the output until they are joined. That is all that there is to go
on from after Ctrl-C or a kill: ``resume`` leaves out the parts that are there. A part appears whole or not at all, and
one of another encode is named when they are joined.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from decogs.codec.scene.digest import digest
from decogs.formats.errors import UsageError
from decogs.formats.files.outputs import STREAM, GrowingFile, Output, check_outputs, is_device, write_whole
from decogs.formats.rigs import Rig, open_rig, without_cameras
from decogs.formats.system.callbacks import OnProgress, OnWarning
from decogs.rig.mattes import open_mattes
from decogs.rig.pictures.ingest import frame_span
from decogs.rig.pictures.recording_digests import is_current

from ..backends import check_device
from ..encoding import chosen_settings, files_of_job, source_of, wanted_effects
from ..input.imported_keyframe import KeyframeSource
from ..input.imported_splats import SplatSource
from ..input.sound import AUTO, NONE
from ..job.job import EncodeJob, PathLike
from ..output.resume import is_expendable
from ..parts.base import Base, read_base
from ..parts.joining import JoinReport, join
from ..parts.manifest import frames_read
from ..parts.output import is_of_part
from .ray_engine import RayEngine
from .tasks import Outcome

_KEYFRAME_NAME = "key.dgs"


class Engine(Protocol):
    """What runs parts of a take; a context manager. ``notice``: what the user should know of it, "" for nothing."""

    @property
    def notice(self) -> str: ...

    def __enter__(self) -> object: ...

    def __exit__(self, *given: object) -> None: ...

    def run(
        self, job: EncodeJob, parts: Sequence[range], keyframe: bytes | None
    ) -> Iterator[tuple[range, Outcome] | int]:
        """Each part's outcome as it comes, and meanwhile the number of frames that are done."""
        ...


def encode_on_cluster(
    job: EncodeJob,
    cluster: str,
    *,
    progress: OnProgress | None = None,
    on_warning: OnWarning | None = None,
    new_engine: Callable[..., Engine] = RayEngine,
) -> JoinReport:
    """Encodes a job with closed segments, each segment as a task; the stream has the bytes that `encode` writes.

    ``cluster``: "local" or the address of a Ray cluster (`RayEngine`). Its machines find the rig, and ``job.keyframe``,
    under the paths given here, and have the same releases installed. ``job.threads``: of each task; 0 is one.
    ``job.resume``: go on with what is in ``output`` + ".parts". ``progress``: frames done, and frames in all.
    ``new_engine``: makes what runs the tasks, as `RayEngine` is made. Raises the errors of `encode`, UsageError without
    Ray, TryAgainError when the cluster fails.
    """
    if not (job.segment and job.closed):
        raise UsageError("`cluster`: tasks are closed segments; add `segment` and `closed`")
    if isinstance(job.rig, Rig) or not isinstance(job.output, (str, os.PathLike)):
        raise UsageError("`cluster`: give paths as `rig` and `output`, which every machine finds")
    check_device(job.device)
    chosen = chosen_settings(job)
    stream, rig = Path(job.output), open_rig(job.rig)
    for warning in rig.warnings:
        _warn(on_warning, warning)
    take = frame_span(rig, job.frames)
    mattes = open_mattes(job.mattes, without_cameras(rig, job.exclude), take, job.holdout)
    check_outputs([Output("output", stream, grows=True, format=STREAM)], files_of_job(job, rig, mattes))
    task = replace(
        job,
        rig=os.fspath(rig.path.absolute()),
        settings=chosen,
        effects=wanted_effects(job, chosen),
        switches=None,
        targets=None,
        frames=take,
        holdout=tuple(job.holdout),
        exclude=tuple(job.exclude),
        keyframe=None if job.keyframe is None else os.fspath(Path(job.keyframe).absolute()),
        audio=_everywhere(job.audio, rig),
        resume=False,
        threads=0,
    )
    engine = new_engine(cluster, threads=job.threads, device=job.device)
    if not (job.resume or is_device(stream)):
        GrowingFile(stream, resumable=False).release()  # What cannot be written is said before the training.
    folder = _folder(stream, resume=job.resume)

    def run(task: EncodeJob, parts: Sequence[range], key: bytes | None, files: dict[range, Path], done: int) -> None:
        """Runs parts and writes each one under its name as it comes; raises UsageError for one that cannot be."""
        most, warned = done, set[str]()
        for event in engine.run(task, parts, key):
            if isinstance(event, int):
                most = max(most, done + event)
                if progress is not None:
                    progress(min(most, len(take)), len(take))
                continue
            part, outcome = event
            _check(outcome)
            for warning in outcome.warnings:
                if warning not in warned:
                    _warn(on_warning, warning)
            warned.update(outcome.warnings)
            write_whole(files[part], outcome.data, expendable=partial(is_expendable, is_of_part))

    with engine:
        if engine.notice:
            _warn(on_warning, engine.notice)
        key = folder / _KEYFRAME_NAME
        if not _is_part(key):
            first = range(take.start, take.start + 1)
            run(task, [first], None, {first: key}, 0)
        _check_resumed(key, task, take, rig)
        files = {part: folder / f"{part.start}-{part.stop}.dgs" for part in _segments(take, job.segment)}
        missing = [
            part
            for part, path in files.items()
            if not (_is_part(path, of=key) and is_current(path, rig, frames_read(part, take, chosen)))
        ]
        done = len(take) - sum(map(len, missing))
        rest = replace(task, keyframe=None, threads=max(1, job.threads))
        run(rest, missing, key.read_bytes(), files, done)
    report = join(list(files.values()), stream, resume=job.resume)
    _remove([key, *files.values()], folder, on_warning)
    return report


def _check_resumed(key: Path, job: EncodeJob, take: range, rig: Rig) -> None:
    """Raises UsageError when the keyframe that is there is that of other recordings or options."""
    base = _part_at(key)
    if not is_current(key, rig, range(take.start, take.start + 1)):
        raise UsageError(
            f"{key}: the first frame's recordings are newer; delete it and the parts beside it to start over"
        )
    base.settings(chosen_settings(job), wanted_effects(job, chosen_settings(job)))
    header = base.keyframe.header
    was: dict[str, Any] = {"frames": base.part.take, "holdout": set(header.held_out), "metrics": base.part.metrics}
    now: dict[str, Any] = {"frames": take, "holdout": set(job.holdout), "metrics": job.metrics}
    was |= {name: header.settings.get(name) for name in ("seed", "scale")}
    now |= {"seed": job.seed, "scale": job.scale}
    was["keyframe"], now["keyframe"] = True, _begins_with(source_of(job), base)
    if changed := [name for name in was if was[name] != now[name]]:
        raise UsageError(
            f"{key.parent}: its encode had another `{changed[0]}`; give the same options, or delete its parts"
        )


def _begins_with(source: KeyframeSource | SplatSource | None, base: Base) -> bool:
    """Whether a take's first keyframe can be that of this ``source``; without any, it is none of a file's Gaussians."""
    if isinstance(source, KeyframeSource):
        return digest(source.state) == digest(base.source.state)
    of_file = base.keyframe.header.settings.get("keyframe", {})
    return of_file == source.document if source is not None else "sha256" not in of_file


def _is_part(path: Path, *, of: Path | None = None) -> bool:
    """Whether a part is there; raises UsageError for what is no part, or none of the same take as the part ``of``."""
    if not os.path.lexists(path):
        return False
    base = _part_at(path)
    if of is not None and (problem := base.difference(_part_at(of))):
        raise UsageError(f"{path}: it does not belong to {of}: {problem}; move it away, or delete it")
    return True


def _part_at(path: Path) -> Base:
    try:
        base = read_base(path)
    except UsageError:
        base = None
    if base is None:
        raise UsageError(f"{path}: this is no part of a take, or it is damaged; move it away, or delete it")
    return base


def _remove(parts: Sequence[Path], folder: Path, on_warning: OnWarning | None) -> None:
    """Removes the parts that were joined, and their folder if nothing else is in it."""
    for path in parts:
        path.unlink(missing_ok=True)
    if others := sorted(path.name for path in folder.iterdir()):
        _warn(on_warning, f"{folder}: it stays, since {others[0]} in it is none of this encode's parts")
    else:
        with suppress(OSError):  # It is a link, or somebody has put something there just now.
            folder.rmdir()


def _check(outcome: Outcome) -> None:
    if outcome.problem:
        raise UsageError(outcome.problem)


def _segments(take: range, segment: int) -> list[range]:
    return [range(start, min(start + segment, take.stop)) for start in range(take.start, take.stop, segment)]


def _everywhere(audio: PathLike | None, rig: Rig) -> PathLike | None:
    """The same, a file by its absolute path; a camera's name stays."""
    is_name = audio is None or str(audio) in (AUTO, NONE, *(camera.name for camera in rig.cameras))
    return audio if is_name else os.fspath(Path(str(audio)).absolute())


def _folder(output: Path, *, resume: bool) -> Path:
    """Where parts are kept until they are joined; raises UsageError if some are there that nobody asked for."""
    folder = output.with_name(output.name + ".parts")
    if not resume and folder.is_dir() and any(folder.iterdir()):
        if not (folder / _KEYFRAME_NAME).exists():
            raise UsageError(f"{folder}: parts are kept there, and it is not empty; move what is in it away")
        raise UsageError(f"{folder}: an encode that was cut off left it; `resume` goes on with it, or move it away")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise UsageError(f"{folder}: {error.strerror}, and parts are kept there; choose another `output`") from None
    return folder


def _warn(on_warning: OnWarning | None, text: str) -> None:
    if on_warning is not None:
        on_warning(text)
