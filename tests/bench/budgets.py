"""Measures what budgets of time and of bytes leave of a moving scene's quality, beside the presets.

    python tests/bench/budgets.py [--scene fast] [--frames 30] [--work FOLDER] [--only time|bytes] [--output FILE.md]

Clips are small, so that a busy machine can do it: `panoptic_basketball` with 8 of its 31 cameras and 2 held out at
128x72, `stage` with 8 and 2 at 112x84, and `fast`, which is made here: 6 and 1 at 80x60. All runs of a clip begin
with the same keyframe of 2 500 Gaussians; what presets make is kept in the folder and not made again. Time is counted
in work: each kernel call moves the encoder's clock by what it takes on a quiet core, by its tiles, Gaussians, rays and
pixels (`WorkClock`). A run then has the same figures
whatever else the machine does; fixed costs of Python are left out.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np

import decogs.encoder.frame.encode_frame as encode_frame
import decogs.encoder.frame.plan as plan
import decogs.encoder.methods.decogs as decogs
import decogs.encoder.training.emergence as emergence
import decogs.encoder.training.seeding as seeding
from decogs.decoder.output.pictures import to_8bit
from decogs.decoder.rendering.views import render_view
from decogs.encoder import PRESETS, EffectChoice, EncodeReport, EncodeSettings, Targets
from decogs.encoder.backends.cpu.fixed_view import CpuFixedView
from decogs.encoder.change.masks import MaskMemory
from decogs.encoder.coding.time_control import counted_seconds
from decogs.encoder.training.frame_training import FrameTraining
from decogs.formats.cameras import Camera, scale_camera
from decogs.formats.rigs import open_rig, read_frames
from decogs.formats.splats import SH_C0, Splats, join_splats
from encode_rig import encode_rig as encode

DATA = Path(__file__).parents[3] / "shared" / "data"
EFFECTS = EffectChoice("none", {"motion", "appearance_change", "emergence", "disappearance"})
CAP = 2500
TIME_SHARES, BYTE_SHARES = (2.0, 1.0, 0.5, 0.25), (1.0, 0.5, 0.25)


class WorkClock:
    """Seconds of work done so far, by what a quiet core takes in microseconds per tile, row or pixel."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now

    def counting(self) -> ExitStack:
        """While this is open, the encoder's clock is this one."""
        stack = ExitStack()
        stack.enter_context(patch.object(time, "perf_counter", self))
        for owner, name, cost in (
            (
                CpuFixedView,
                "draw",
                lambda _, view, moving, *rest, **more: 300 + 20 * view.met.sum() + 0.3 * len(moving),
            ),
            (CpuFixedView, "loss", lambda _, view, *rest, **more: 100 + 10 * view.met.sum()),
            (
                CpuFixedView,
                "backward",
                lambda _, view, *rest, **more: 200 + 20 * view.met.sum() + 0.2 * len(view._drawn[1]),
            ),
            (CpuFixedView, "redraw", lambda _, view, *rest: 300 + 15 * view.met.size + 0.05 * len(view._loaded())),
            (CpuFixedView, "commit", lambda _, view, scene, rows, *rest: 100 + 0.2 * len(rows) + 0.02 * len(scene)),
            (CpuFixedView, "detach", lambda _, view, rows: 50 + 0.1 * len(rows)),
            (decogs, "shared_displacements", lambda _, means, *rest: 2 * len(means)),
            (FrameTraining, "errors", lambda out, *rest: 0.05 * sum(each.shape[1] for each in out)),
            (decogs, "frame_training", lambda made, *rest: 0.003 * sum(each[0].size for each in made.frame.pictures)),
            (decogs, "densify", lambda _, training, work, *rest: 2000 + 1.0 * len(work.rows)),
            (decogs, "revert_insignificant", lambda _, optimiser, *rest: 0.2 * len(optimiser.splats)),
            (emergence, "missed_pixels", lambda _, look, *rest: 0.005 * look.depth.size),
            (seeding._Search, "__init__", lambda _, search, views, *rest: 0.1 * sum(x.depth.size for x in views)),
            (
                seeding._Search,
                "along_rays",
                lambda _, search, rays: len(search._views) * (800 + 20 * len(rays.pixels)),
            ),
            (MaskMemory, "pixel_changes", lambda _, memory, now, *rest: 0.02 * sum(each[0].size for each in now)),
            (MaskMemory, "trained", lambda _, memory, now, *rest, **more: 0.02 * sum(each[0].size for each in now)),
            (plan, "select", lambda _, evidence, *rest: 0.01 * len(evidence) * len(evidence[0].weight)),
            (encode_frame, "frame_packet", lambda written, *rest, **more: 2000 + 0.3 * len(written.packet.payload)),
        ):
            stack.enter_context(patch.object(owner, name, self._counted(getattr(owner, name), cost)))
        return stack

    def _counted(self, call: Callable[..., Any], cost: Callable[..., float]) -> Callable[..., Any]:
        def counted(*arguments: Any, **options: Any) -> Any:
            result = call(*arguments, **options)
            self.now += 1e-6 * float(cost(result, *arguments, **options))
            return result

        return counted


@dataclass(frozen=True)
class Clip:
    """A rig on disk and the cameras to hold out."""

    rig: Path
    frames: int
    held_out: tuple[str, ...]


# The clips


def write_rig(folder: Path, cameras: Sequence[Camera], pictures: Sequence[Sequence[np.ndarray]]) -> None:
    """rig.json and a folder of PNG per camera; ``pictures`` by frame and camera, (H, W, 3) uint8 RGB."""
    for camera in cameras:
        (folder / camera.name).mkdir(parents=True, exist_ok=True)
    for index, frame in enumerate(pictures):
        for camera, picture in zip(cameras, frame, strict=True):
            cv2.imwrite(str(folder / camera.name / f"{index:04d}.png"), picture[..., ::-1])
    (folder / "rig.json").write_text(json.dumps(rig_document(cameras, [camera.name for camera in cameras])))


def rig_document(cameras: Sequence[Camera], files: Sequence[str]) -> dict[str, Any]:
    """The cameras as rig.json has them, without lenses, with their folders of pictures or videos."""
    entries = []
    for camera, file in zip(cameras, files, strict=True):
        values = {name: getattr(camera, name) for name in ("name", "width", "height", "fx", "fy", "cx", "cy")}
        pose = np.asarray(camera.world_to_camera).tolist()
        entries.append({**values, "file": file, "distortion_model": "none", "distortion": [], "world_to_camera": pose})
    told = {
        "pixel_convention": "the centre of the top-left pixel is (0.5, 0.5)",
        "fps": 30,
        "source": "bench",
        "licence": "see source",
    }
    return {**told, "cameras": entries}


def smaller(source: Path, folder: Path, names: Sequence[str], scale: float, frames: int) -> None:
    """Some cameras of a rig, scaled down."""
    rig = open_rig(source)
    cameras = [scale_camera(next(c for c in rig.cameras if c.name == name), scale) for name in names]
    pictures = [
        [cv2.resize(p, (c.width, c.height), interpolation=cv2.INTER_AREA) for p, c in zip(shown, cameras, strict=True)]
        for _, shown in read_frames(rig, 0, min(frames, rig.frame_count), names=list(names))
    ]
    write_rig(folder, cameras, pictures)


def patch_of(across: int, down: int, spacing: float, seed: int) -> Splats:
    """A textured rectangle of opaque Gaussians around the origin, facing along z."""
    random = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(across) - (across - 1) / 2, np.arange(down) - (down - 1) / 2)
    count = across * down
    means = np.stack([x.ravel() * spacing, y.ravel() * spacing, np.zeros(count)], axis=1)
    log_scales = np.tile(np.log([0.6 * spacing, 0.6 * spacing, 0.05 * spacing]), (count, 1))
    colours = cv2.resize(random.uniform(0, 1, (4, 5, 3)), (across, down), interpolation=cv2.INTER_CUBIC).reshape(
        count, 1, 3
    )
    values = (means, log_scales, np.tile([1.0, 0, 0, 0], (count, 1)), np.full(count, 5.0), (colours - 0.5) / SH_C0)
    return Splats(*(np.ascontiguousarray(value, np.float32) for value in values))


def turned_and_moved(splats: Splats, angle: float, place: Sequence[float]) -> Splats:
    """Turned about z and moved; the Gaussians are round in that plane."""
    c, s = np.cos(angle), np.sin(angle)
    means = splats.means @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + np.asarray(place)
    return replace(splats, means=np.ascontiguousarray(means, np.float32))


def fast_clip(folder: Path, frames: int) -> None:
    """Three textured plates before a wall, about 4 pixels a frame: to and fro, round, and turning."""

    @dataclass(frozen=True)
    class Lookup:
        cameras: tuple[Camera, ...]
        background: tuple[float, float, float] = (0.0, 0.0, 0.0)

    cameras = []
    for index in range(7):
        angle = np.radians(-30 + 10 * index)
        pose = np.eye(4)
        pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
        pose[:3, 3] = [0, 0.08 * (-1) ** index, 2]
        cameras.append(Camera(f"cam{index:02d}", 80, 60, 68.0, 68.0, 40.0, 30.0, pose))
    wall = turned_and_moved(patch_of(70, 44, 0.09, 1), 0, (0, 0, 0.6))
    plates = [patch_of(9, 9, 0.05, seed) for seed in (2, 3, 4)]
    pictures = []
    for frame in range(frames):
        swing = 0.55 * (2 * abs((frame / 10) % 2 - 1) - 1)
        around = 2 * np.pi * frame / 24
        places = ((swing, -0.3, -0.2), (0.45 * np.cos(around), 0.1 + 0.3 * np.sin(around), -0.05), (-swing, 0.35, 0.1))
        scene = wall
        for plate, place, turn in zip(plates, places, (0.0, 0.2 * frame, -0.12 * frame), strict=True):
            scene = join_splats(scene, turned_and_moved(plate, turn, place))
        seen = [render_view(Lookup((c,)), scene, c.name).image for c in cameras]  # type: ignore[arg-type]
        pictures.append([to_8bit(image) for image in seen])
    write_rig(folder, cameras, pictures)


def clip(name: str, work: Path, frames: int) -> Clip:
    """The clip of that name, written when it is not there."""
    folder = work / f"{name}{frames}"
    names = [f"cam{i:02d}" for i in range(31)]
    chosen = {
        "basketball": ([*names[0:30:4], "cam06", "cam18"], ("cam06", "cam18")),
        "stage": (names[:10], ("cam02", "cam07")),
    }
    used, held = chosen.get(name, (names[:7], ("cam03",)))
    if not (folder / "rig.json").exists():
        if name == "basketball":
            smaller(DATA / "real" / "panoptic_basketball", folder, used, 0.2, frames)
        elif name == "stage":
            smaller(DATA / "rigs" / "stage", folder, used, 1 / 3, frames)
        else:
            fast_clip(folder, frames)
    return Clip(folder, open_rig(folder).frame_count, held)


# The runs


def settings_of(preset: str) -> EncodeSettings:
    """The preset with a small keyframe."""
    return replace(PRESETS[preset], keyframe=replace(PRESETS["live"].keyframe, cap=CAP))


@dataclass(frozen=True)
class Row:
    """A run: mean dB of the held-out and of the training views in the first and the last third of the later frames."""

    name: str
    seconds: float
    kilobytes: float
    first: float
    last: float
    training_first: float
    training_last: float
    worst: float
    held: int


def run(clip: Clip, keyframe: Path | None, output: Path, preset: str, **options: Any) -> EncodeReport:
    """An encode on the work clock; ``options`` are those of ``encode``."""
    with WorkClock().counting():
        return encode(
            clip.rig, output, settings_of(preset), effects=EFFECTS, threads=1,
            keyframe=keyframe, holdout=clip.held_out, **options,
        )  # fmt: skip


def row(name: str, report: EncodeReport) -> Row:
    later = report.frames[1:]
    third = max(1, len(later) // 3)
    held_out = [frame.held_out_psnr or 0.0 for frame in later]
    training = [frame.training_psnr for frame in later]
    means = [float(np.mean(x)) for x in (held_out[:third], held_out[-third:], training[:third], training[-third:])]
    seconds = float(np.mean([counted_seconds(frame.seconds) for frame in later]))
    size = float(np.mean([frame.bytes for frame in later])) / 1e3
    return Row(name, seconds, size, *means, min(held_out), sum(frame.kind == "skip" for frame in later))


def rows(clip: Clip, work: Path, only: str | None, tell: Callable[[Row], None]) -> list[Row]:
    """All runs of a clip."""
    key = clip.rig / "key.dgs"
    if not key.exists():
        run(clip, None, key, "live", frames=slice(1))
    done: list[Row] = []
    wanted = ("live", "standard") if only else ("live", "draft", "standard")
    kept = clip.rig / "presets.json"
    known = json.loads(kept.read_text()) if kept.exists() else {}

    def add(name: str, preset: str, **options: Any) -> Row:
        done.append(
            Row(**known[name]) if name in known else row(name, run(clip, key, work / f"{name}.dgs", preset, **options))
        )
        if not options:
            known[name] = vars(done[-1])
            kept.write_text(json.dumps(known))
        tell(done[-1])
        return done[-1]

    presets = {name: add(name, name) for name in wanted}
    if only in (None, "time"):
        for share in TIME_SHARES:
            add(f"time x {share:g}", "standard", targets=Targets(time_budget=share * presets["live"].seconds))
    if only in (None, "bytes"):
        for share in BYTE_SHARES:
            add(
                f"bytes x {share:g}",
                "standard",
                targets=Targets(bytes_per_frame=share * presets["standard"].kilobytes * 1e3),
            )
    return done


def table(name: str, done: Sequence[Row]) -> str:
    lines = [
        f"### {name}\n",
        "| run | work-s a frame | kB a frame | held-out dB, first / last third | training dB, first / last third "
        "| worst frame | held frames |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {r.name} | {r.seconds:.3f} | {r.kilobytes:.1f} | {r.first:.2f} / {r.last:.2f} "
        f"| {r.training_first:.2f} / {r.training_last:.2f} | {r.worst:.2f} | {r.held} |"
        for r in done
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", action="append", choices=("basketball", "stage", "fast"))
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--only", choices=("time", "bytes"))
    parser.add_argument("--work", type=Path, default=Path("build/budgets"))
    parser.add_argument("--output", type=Path)
    given = parser.parse_args()
    given.work.mkdir(parents=True, exist_ok=True)
    pages = []
    for name in given.scene or ("basketball", "stage", "fast"):
        made = clip(name, given.work, given.frames)
        pages.append(
            table(f"{name}, {made.frames} frames", rows(made, given.work, given.only, lambda r: print(r, flush=True)))
        )
        print(pages[-1], flush=True)
    if given.output:
        given.output.write_text("\n".join(pages))


if __name__ == "__main__":
    main()
