"""What all runs of a report share, and one of them: plain values, as they lie in its JSON file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from decogs.formats.frames.ranges import Frames

from ..measures.quality import FrameOfViews
from ..questions.variants import Variant
from .documents import read_document

FORMAT = 1
"""Of the JSON files; raise it when what is measured changes."""

KEYFRAME = Variant("keyframe", "the keyframe that all variants start from", frames=1, own_keyframe=True)


@dataclass(frozen=True)
class BenchOptions:
    """What all runs of a report share.

    ``holdout``: cameras to measure on; the rig's own, or cam00, when there are none. ``preset``: what variants start
    from. ``frames``, ``scale``, ``threads``: as ``encode``'s. ``seeds``: every variant is run with each of them;
    figures are means, and what shows one run shows the first's. ``any_code``: take results that other code made.
    ``keep_streams``: leave the .dgs files.
    """

    holdout: Sequence[str] = ()
    frames: Frames = None
    scale: float = 1.0
    preset: str = "standard"
    threads: int = 0
    seeds: Sequence[int] = (0,)
    any_code: bool = False
    keep_streams: bool = False


@dataclass(frozen=True)
class FrameCost:
    """What a run keeps of one FrameReport; ``frame`` is the rig's index, whatever the stride.

    ``seconds``: wall clock by stage; ``cpu_seconds``: all cores added; both without measuring.
    """

    frame: int
    kind: str
    bytes: int
    gaussians: int
    selected: float
    training_psnr: float
    seconds: dict[str, float]
    cpu_seconds: float


@dataclass(frozen=True)
class RunFrame(FrameOfViews, FrameCost):
    """One frame of a run: what it cost and how it looks, in one line of the JSON file."""


@dataclass(frozen=True)
class Run:
    """One variant over one rig, and how it was obtained; plain values, as they lie in the JSON file.

    ``key``: digest of what decides the run. ``span``: the rig's frames, start, stop and step. ``load``: of the machine
    before and after. ``changed``: settings that differ from the preset's. ``render_seconds``, ``read_seconds``: medians
    per frame. ``decode_cpu_seconds``: of both together, in processor seconds, all cores added; ``read_cpu_seconds``: to
    read a frame, the mean; ``first_cpu_seconds``: to read and render the first; None in a file from before they were
    measured. ``stream_bytes``: the file's. ``column``:
    image column of the held-out camera that is kept in the picture beside the JSON file.
    """

    rig: str
    variant: str
    description: str
    key: str
    code: str
    date: str
    machine: dict[str, Any]
    load: list[float]
    camera: str
    span: list[int]
    scale: float
    seed: int
    threads: int
    preset: str
    command: str
    changed: dict[str, str]
    settings: dict[str, Any]
    masks: str
    lpips_network: str | None
    render_seconds: float
    read_seconds: float
    stream_bytes: int
    column: int
    frames: list[RunFrame]
    decode_cpu_seconds: float | None = None
    read_cpu_seconds: float | None = None
    first_cpu_seconds: float | None = None


def read_run(path: Path) -> Run | None:
    """A run from its JSON file; None when the file is damaged or of another format."""
    return read_document(path, Run, RunFrame)
