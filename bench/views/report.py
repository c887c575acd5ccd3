"""The report of viewpoints: every rig with each camera left out in turn, as Markdown with pictures, and as JSON."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TextIO

from decogs.encoder.output.observer import EncodeObserver
from decogs.encoder.output.reports import FrameReport
from decogs.formats.files.outputs import Output, check_folder_name, check_outputs, write_whole
from decogs.formats.rigs import files_of

from ..estimates import mean
from ..machine import code_version, machine_facts
from ..measures.regions import measured_size
from ..runs.progress import BenchProgress
from ..runs.rigs import check_names
from ..tables.columns import markdown, number
from .left_out import LeftOut, LeftOutOptions, RigViewpoints

NAME = "views"
_PICTURES = 2
"""Worst viewpoints of a rig that are shown."""
_HEADINGS = [
    "last frame", "subject", "rest", "seen by two", "elsewhere", "share seen", "training views", "training − left out",
    "haze, %", "haze beside, %", "floaters", "Gaussians", "kB, first frame", "CPU-s",
]  # fmt: skip


@dataclass(frozen=True)
class _Figures:
    """Means over a camera's frames, or over cameras; dB, shares, counts, kB of the first frame, CPU-seconds of all."""

    psnr: float | None
    last: float | None
    subject: float | None
    rest: float | None
    seen_psnr: float | None
    unseen_psnr: float | None
    seen: float | None
    training: float | None
    haze: float | None
    haze_beside: float | None
    floaters: float | None
    gaussians: float | None
    kilobytes: float | None
    seconds: float | None

    def cells(self) -> list[str]:
        gap = None if self.training is None or self.psnr is None else self.training - self.psnr
        decibels = number(".2f")
        return [
            *(decibels(value) for value in (self.psnr, self.last, self.subject, self.rest)),
            *(decibels(value) for value in (self.seen_psnr, self.unseen_psnr)),
            number(".0%")(self.seen),
            decibels(self.training),
            number("+.2f")(gap),
            *(number(".2f")(None if value is None else 100 * value) for value in (self.haze, self.haze_beside)),
            *(number(".0f")(value) for value in (self.floaters, self.gaussians, self.kilobytes)),
            number(".1f")(self.seconds),
        ]


class _Told(EncodeObserver):
    """Passes an encode's steps on to the report's bar."""

    def __init__(self, progress: BenchProgress) -> None:
        self._progress = progress

    def keyframe_step(self, step: int, steps: int, loss: float) -> None:
        self._progress.keyframe_step(step, steps, loss)

    def frame(self, report: FrameReport) -> None:
        self._progress.frame()


def make_views_report(
    rig_dirs: Sequence[str | os.PathLike[str]],
    output: str | os.PathLike[str],
    options: LeftOutOptions | None = None,
    *,
    command: str = "",
    terminal: TextIO | None = None,
) -> Path:
    """Encodes every rig without each camera in turn, writes the report into the folder ``output``, returns its file.

    What an earlier report left in ``output`` is not made again. Raises DecogsError for what cannot be encoded.
    """
    folder, options = Path(output), options or LeftOutOptions()
    check_folder_name(folder)
    rigs = [RigViewpoints(rig_dir, folder, options) for rig_dir in rig_dirs]
    check_names([rig.rig for rig in rigs])
    written = [Output("output", folder / f"{NAME}{suffix}", grows=True) for suffix in (".md", ".json")]
    check_outputs(written, [file for rig in rigs for file in files_of(rig.rig)])
    folder.mkdir(parents=True, exist_ok=True)
    _run_missing(rigs, terminal)
    results = {rig.name: [result for camera in rig.left_out if (result := rig.find(camera))] for rig in rigs}
    write_whole(folder / f"{NAME}.json", _document(results, command).encode())
    path = folder / f"{NAME}.md"
    write_whole(path, ("\n".join(_page(rigs, results, folder, command)) + "\n").encode())
    return path


def _run_missing(rigs: Sequence[RigViewpoints], terminal: TextIO | None) -> None:
    missing = [(rig, camera) for rig in rigs for camera in rig.left_out if rig.find(camera) is None]
    with BenchProgress(sum(len(rig.frames) for rig, _ in missing), terminal) as progress:
        for rig, camera in missing:
            progress.started(rig.name, f"without {camera}")
            result = rig.run(camera, _Told(progress))
            progress.measured(rig.name, f"without {camera}", [frame.psnr for frame in result.frames])


def _page(rigs: Sequence[RigViewpoints], results: dict[str, list[LeftOut]], folder: Path, command: str) -> list[str]:
    made = f"Made by `{command}`. " if command else ""
    lines = ["# Viewpoints where no camera stood, measured", "", f"{made}Each camera of a rig is left out in turn.", ""]
    heads = ["cameras left out", "PSNR", "worst", *_HEADINGS]
    rows = []
    for rig in rigs:
        of_cameras = [_of_camera(result) for result in results[rig.name]]
        cells = _average(of_cameras).cells()
        worst = min(figures.psnr for figures in of_cameras if figures.psnr is not None)
        rows.append([rig.name, str(len(of_cameras)), cells[0], f"{worst:.2f}", *cells[1:]])
    lines += [*markdown(["rig", *heads], rows), ""]
    for rig in rigs:
        lines += _rig_section(rig, results[rig.name], folder)
    return lines + _how(results)


def _rig_section(rig: RigViewpoints, results: Sequence[LeftOut], folder: Path) -> list[str]:
    ranked = sorted(results, key=lambda result: mean(frame.psnr for frame in result.frames) or 0.0)
    frames = f"frame {rig.frames[0]}" if len(rig.frames) == 1 else f"frames {rig.frames[0]} to {rig.frames[-1]}"
    sizes = ", ".join(dict.fromkeys(measured_size(rig.rig, result.camera, result.scale) for result in results))
    rows = [[result.camera, *_of_camera(result).cells(), f"`{rig.file_of(result.camera).stem}`"] for result in results]
    rows.append(["mean", *_average([_of_camera(result) for result in results]).cells(), ""])
    lines = [
        f"## {rig.name}",
        "",
        f"{len(rig.rig.cameras)} cameras, {frames}. Pictures of {sizes}. Left out:",
        "",
        *markdown(["", "PSNR", *_HEADINGS, "how"], rows),
        "",
    ]
    for result in ranked[:_PICTURES]:
        picture = rig.picture_of(result.camera).relative_to(folder).as_posix()
        lines += [f"![{result.camera} of {rig.name}: recorded, decoded, and what two cameras see]({picture})", ""]
    return lines


def _of_camera(result: LeftOut) -> _Figures:
    frames = result.frames
    return _Figures(
        psnr=mean(frame.psnr for frame in frames),
        last=frames[-1].psnr,
        subject=mean(frame.psnr_subject for frame in frames),
        rest=mean(frame.psnr_rest for frame in frames),
        seen_psnr=mean(frame.psnr_seen for frame in frames),
        unseen_psnr=mean(frame.psnr_unseen for frame in frames),
        seen=mean(frame.seen for frame in frames),
        training=mean(frame.training_psnr for frame in frames),
        haze=mean(frame.haze for frame in frames),
        haze_beside=mean(frame.haze_beside for frame in frames),
        floaters=mean(frame.floaters for frame in frames),
        gaussians=frames[-1].gaussians,
        kilobytes=frames[0].bytes / 1e3,
        seconds=sum(frame.cpu_seconds for frame in frames),
    )


def _average(all_figures: Sequence[_Figures]) -> _Figures:
    columns = [asdict(figures) for figures in all_figures]
    return _Figures(**{name: mean(column[name] for column in columns) for name in columns[0]})


def _document(results: dict[str, list[LeftOut]], command: str) -> str:
    """The report as data: each camera's figures by rig; runs/ has them frame by frame."""
    rigs = {name: {each.camera: asdict(_of_camera(each)) for each in left_out} for name, left_out in results.items()}
    facts = {"report": NAME, "command": command, "code": code_version(), "machine": machine_facts(), "rigs": rigs}
    return json.dumps(facts, indent=1) + "\n"


def _how(results: dict[str, list[LeftOut]]) -> list[str]:
    left_out = [each for of_rig in results.values() for each in of_rig]
    codes, seeds = ({getattr(each, name) for each in left_out} for name in ("code", "seed"))
    return [
        "## How these figures were obtained",
        "",
        f"- Code {', '.join(sorted(codes))}; seed {', '.join(map(str, sorted(seeds)))}; one encode for each camera.",
        "- The camera left out never reaches training. Its view is decoded from the file at the size stated, "
        "lens included, rounded to 8 bit and compared with what it recorded. PSNR in dB, means over the frames.",
        "- Seen by two: over the pixels whose surface at least two training cameras see; elsewhere: over the others. "
        "So views between the cameras are apart from views beyond the rig. The surfaces are those of the same "
        "frames encoded with all cameras (references/), which only measures.",
        "- Subject, rest: inside and outside the rig's true mattes (truth/mattes), where it has them.",
        "- Haze: alpha before the first surface, mean over the picture; beside: from a viewpoint midway to the "
        "nearest camera. Floaters: Gaussians that make it: they end before nine tenths of the way to the surface.",
        "- CPU-s: of the whole encode, all cores added, measuring left out.",
        "- The pictures: recorded, decoded, and decoded with what no two training cameras see in the dark.",
    ]
