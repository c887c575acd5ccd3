"""Every camera of a rig left out in turn: what a viewer sees where no camera stood.

Each camera's encode is kept as one JSON file with a picture beside it, as `runs` keeps variants, so that an interrupted
report goes on where it stopped. The reference, the same frames encoded with all cameras, is kept whatever the code:
reports made before and after a change are then about the same pixels. Remove OUTPUT/references to make it again.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.decoder.output.pictures import to_8bit
from decogs.decoder.reading.stream import open_stream
from decogs.decoder.rendering.views import render_view
from decogs.encoder.backends.psnr import psnr_of
from decogs.encoder.encoding import encode
from decogs.encoder.job.job import EncodeJob
from decogs.encoder.output.observer import EncodeObserver
from decogs.encoder.settings.encode import EncodeSettings
from decogs.encoder.settings.presets import preset
from decogs.formats.cameras import scale_camera
from decogs.formats.errors import UsageError
from decogs.formats.files.outputs import write_whole
from decogs.formats.frames.ranges import Frames
from decogs.formats.rigs import open_rig
from decogs.formats.splats import Splats
from decogs.formats.system.threads import thread_count
from decogs.rig.pictures.ingest import frame_span

from ..estimates import rounded
from ..machine import code_version, machine_facts
from ..measures.metrics import BytePicture, Mask, psnr, square_error_map
from ..measures.regions import held_out_pictures, true_mattes
from ..runs.documents import digest, document, read_document
from ..runs.rigs import result_name
from .surfaces import Surfaces, in_two, midway

REFERENCE = "standard"
"""Preset of the encode with all cameras whose surfaces say what the others see."""
_UNSEEN = 0.35
"""Brightness that a picture keeps where no two training cameras see the surface."""


@dataclass(frozen=True)
class LeftOutOptions:
    """What all encodes of a report share.

    ``cameras``: how many to leave out, evenly among the rig's, or their names; all when None. ``settings``: a preset's
    name, effects as detected, or settings, effects as they say. ``frames``, ``scale``, ``threads``, ``seed``: as
    ``encode``'s; the first frame alone when ``frames`` is None. ``any_code``: take results that other code made.
    """

    cameras: int | Sequence[str] | None = None
    frames: Frames = None
    scale: float = 1.0
    settings: str | EncodeSettings = "standard"
    threads: int = 0
    seed: int = 0
    any_code: bool = False


@dataclass(frozen=True)
class LeftOutFrame:
    """One frame as the camera that was left out sees it, and what it cost. PSNR in dB.

    ``psnr_seen``: over the ``seen`` share of the pixels, whose surface two or more training cameras see; None without
    such pixels. ``psnr_unseen``: over the others. ``psnr_subject``, ``psnr_rest``: inside and outside the rig's true
    matte; None without one. ``training_psnr``: mean of the training cameras. ``haze``,
    ``floaters``: what hangs in free space before the camera; ``haze_beside``: before a viewpoint midway to its nearest
    neighbour.
    """

    frame: int
    psnr: float
    psnr_seen: float | None
    psnr_unseen: float | None
    psnr_subject: float | None
    psnr_rest: float | None
    seen: float
    training_psnr: float
    haze: float
    haze_beside: float
    floaters: int
    gaussians: int
    bytes: int
    cpu_seconds: float


@dataclass(frozen=True)
class LeftOut:
    """One camera's result, and how it was obtained; plain values, as they lie in the JSON file."""

    rig: str
    camera: str
    key: str
    code: str
    date: str
    machine: dict[str, Any]
    scale: float
    seed: int
    threads: int
    settings: dict[str, Any]
    frames: list[LeftOutFrame]


class RigViewpoints:
    """One rig of a report: which of its cameras are left out, and the results."""

    def __init__(self, rig_dir: str | os.PathLike[str], output: Path, options: LeftOutOptions) -> None:
        """Raises RigError and UsageError for a rig or options that cannot be measured; nothing is trained yet."""
        self.rig = open_rig(rig_dir)
        self.name = result_name(self.rig)
        self.options = options
        self.settings = preset(options.settings) if isinstance(options.settings, str) else options.settings
        self.frames = frame_span(self.rig, slice(1) if options.frames is None else options.frames)
        names = [camera.name for camera in self.rig.cameras]
        if len(names) < 3:
            raise UsageError(f"{self.rig.path}: has {len(names)} cameras; a report that leaves one out needs 3")
        self.left_out = _chosen(names, options.cameras)
        for name in self.left_out:
            if name not in names:
                raise UsageError(f"`cameras` {name}: {self.rig.path} has no such camera; it has {', '.join(names)}")
        self._threads = thread_count(options.threads)
        self._runs, self._references = output / "runs", output / "references"

    def find(self, camera: str) -> LeftOut | None:
        """The result that an earlier report left, or None."""
        result = read_document(self.file_of(camera), LeftOut, LeftOutFrame)
        return result if result and (self.options.any_code or result.code == code_version()) else None

    def file_of(self, camera: str) -> Path:
        """Where a camera's JSON lies."""
        return self._runs / f"{self.name}-without-{camera}-{self._key(self.settings, camera)}.json"

    def picture_of(self, camera: str) -> Path:
        """The last frame: recorded, decoded, and decoded with what no two training cameras see in the dark."""
        return self.file_of(camera).with_suffix(".jpg")

    def run(self, camera: str, progress: EncodeObserver | None = None) -> LeftOut:
        """Encodes without ``camera``, measures what it sees, keeps the result."""
        self._runs.mkdir(parents=True, exist_ok=True)
        stream = self.file_of(camera).with_suffix(".dgs")
        report = self._encode(stream, self.options.settings, (camera,), self.options.seed, progress)
        if report.interrupted:
            stream.unlink(missing_ok=True)
            raise KeyboardInterrupt
        measured = []
        with open_stream(stream, strict=True) as judged, open_stream(self._reference(progress), strict=True) as whole:
            pictures = held_out_pictures(self.rig, camera, self.frames, self.options.scale)
            mattes = true_mattes(self.rig, camera, self.frames, self.options.scale)
            frames = zip(judged.frames(), whole.frames(), report.frames, pictures, mattes, strict=True)
            for seen, reference, cost, recorded, matte in frames:
                surfaces = Surfaces(whole.header, reference.splats, self._threads)
                looks, picture = self._measure(judged.header, seen.splats, surfaces, camera, recorded, matte)
                costs = {name: getattr(cost, name) for name in ("training_psnr", "gaussians", "bytes", "cpu_seconds")}
                measured.append(LeftOutFrame(**rounded({"frame": cost.frame, **looks, **costs})))
        stream.unlink()
        result = self._result(camera, measured)
        write_whole(self.picture_of(camera), bytes(cv2.imencode(".jpg", picture[..., ::-1])[1].tobytes()))
        write_whole(self.file_of(camera), document(result).encode())
        return result

    def _measure(
        self,
        header: StreamHeader,
        scene: Splats,
        surfaces: Surfaces,
        name: str,
        recorded: BytePicture,
        matte: Mask | None,
    ) -> tuple[dict[str, Any], BytePicture]:
        # The header's cameras, as a viewer takes them: the rig's have no near planes and see their own housings.
        cameras = [scale_camera(camera, self.options.scale) for camera in header.cameras]
        camera = next(camera for camera in cameras if camera.name == name)
        others = [other for other in cameras if other.name != name]
        view = render_view(header, scene, name, scale=self.options.scale, threads=self._threads, corrections={})
        decoded = to_8bit(view.image)
        seen = in_two(surfaces.seen_by(camera, others))
        errors = square_error_map(decoded, recorded)
        before = surfaces.air(header, scene, camera)
        looks = {
            "psnr": psnr_of(float(errors.mean())),
            "psnr_seen": psnr(errors, seen),
            "psnr_unseen": psnr(errors, ~seen),
            "psnr_subject": None if matte is None else psnr(errors, matte),
            "psnr_rest": None if matte is None else psnr(errors, ~matte),
            "seen": float(seen.mean()),
            "haze": before.haze,
            "floaters": before.floaters,
            "haze_beside": surfaces.air(header, scene, midway(camera, others)).haze,
        }
        return looks, np.concatenate([recorded, decoded, _darkened(decoded, seen)], axis=1)

    def _encode(
        self,
        stream: Path,
        settings: str | EncodeSettings,
        left_out: tuple[str, ...],
        seed: int,
        progress: EncodeObserver | None,
    ) -> Any:
        # What an interrupted report left of it is worth nothing: it is timed as a whole.
        stream.with_name(stream.name + ".part").unlink(missing_ok=True)
        stream.unlink(missing_ok=True)
        job = EncodeJob(
            self.rig,
            stream,
            settings,
            frames=self.frames,
            scale=self.options.scale,
            holdout=left_out,
            seed=seed,
            threads=self._threads,
        )
        return encode(job, progress=progress)

    def _reference(self, progress: EncodeObserver | None) -> Path:
        """The same frames encoded with every camera, whatever the settings of the report."""
        settings = preset(REFERENCE)
        path = self._references / f"{self.name}-{self._key(settings, '')}.dgs"
        if not path.is_file():
            self._references.mkdir(parents=True, exist_ok=True)
            if self._encode(path, REFERENCE, (), 0, progress).interrupted:
                path.unlink(missing_ok=True)
                raise KeyboardInterrupt
        return path

    def _key(self, settings: EncodeSettings, left_out: str) -> str:
        """Digest of everything that decides a stream; the reference has no seed of its own."""
        rig, options = self.rig, self.options
        facts = {
            "settings": settings.as_document() if left_out else REFERENCE,
            "effects": "detected" if isinstance(self.options.settings, str) or not left_out else "as set",
            "rig": [self.name, rig.layout, rig.frame_count, [camera.name for camera in rig.cameras]],
            "frames": [self.frames.start, self.frames.stop],
            "options": [left_out, options.scale, options.seed if left_out else 0],
        }
        return digest(facts)

    def _result(self, camera: str, frames: list[LeftOutFrame]) -> LeftOut:
        return LeftOut(
            rig=self.name,
            camera=camera,
            key=self._key(self.settings, camera),
            code=code_version(),
            date=datetime.now(timezone.utc).isoformat(timespec="seconds"),
            machine=machine_facts(),
            scale=self.options.scale,
            seed=self.options.seed,
            threads=self._threads,
            settings=self.settings.as_document(),
            frames=frames,
        )


def _chosen(names: list[str], wanted: int | Sequence[str] | None) -> list[str]:
    """The cameras to leave out: all, those named, or so many, evenly spread."""
    if wanted is None:
        return names
    if not isinstance(wanted, int):
        return list(dict.fromkeys(wanted))
    if wanted < 1:
        raise UsageError(f"`cameras` {wanted}: leave out at least 1")
    count = min(wanted, len(names))
    return [names[number * len(names) // count] for number in range(count)]


def _darkened(picture: BytePicture, seen: Mask) -> BytePicture:
    return np.where(seen[..., None], picture, picture * _UNSEEN).astype(np.uint8)
