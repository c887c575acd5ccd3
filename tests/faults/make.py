"""A rig with one fault made on purpose: some frames of a good one as videos, with a rig.json.

    python tests/faults/make.py RIG blur4 cam03 FOLDER --frames 3:19

All pictures are coded as H.264, nearly lossless: copies in a video are not alike bit for bit.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from numpy.typing import NDArray

sys.path[:0] = [str(Path(__file__).parents[1])] * (str(Path(__file__).parents[1]) not in sys.path)

from decogs.formats.cameras import Camera  # noqa: E402
from decogs.formats.colours.srgb import linear_from_srgb, srgb_from_linear  # noqa: E402
from decogs.formats.rigs import Rig, open_rig, read_frames  # noqa: E402

U8 = NDArray[np.uint8]
Change = Callable[[U8, U8, int], U8]
"""A frame from a camera's pictures (F, H, W, 3), those before them, and the frame's index."""

CRF = "6"
_FROZEN_FROM, _DROPPED_EVERY, _LATE_FRAMES = 5, 7, 3
_DEGREES = 1.0


def _blurred(sigma: float) -> Change:
    return lambda taken, before, frame: cv2.GaussianBlur(taken[frame], (0, 0), sigma)


def _exposed(stops: float) -> Change:
    def change(taken: U8, before: U8, frame: int) -> U8:
        light = linear_from_srgb(taken[frame] / 255.0) * 2.0**stops
        return np.rint(np.asarray(srgb_from_linear(np.clip(light, 0, 1))) * 255).astype(np.uint8)

    return change


def _noisy(levels: float) -> Change:
    def change(taken: U8, before: U8, frame: int) -> U8:
        noise = np.random.default_rng(frame).normal(0, levels, taken[frame].shape)
        return np.clip(np.rint(taken[frame] + noise), 0, 255).astype(np.uint8)

    return change


def _late(taken: U8, before: U8, frame: int) -> U8:
    return np.concatenate([before, taken])[frame + len(before) - _LATE_FRAMES]


PICTURES: dict[str, Change] = {
    "blur2": _blurred(2.0),
    "blur4": _blurred(4.0),
    "frozen": lambda taken, before, frame: taken[0],
    "frozen5": lambda taken, before, frame: taken[min(frame, _FROZEN_FROM)],
    "dead": lambda taken, before, frame: np.zeros_like(taken[0]),
    "dead3": lambda taken, before, frame: taken[frame] if frame < 3 else np.zeros_like(taken[0]),
    "bright": _exposed(1.0),
    "dark": _exposed(-1.0),
    "noise": _noisy(8.0),
    "late3": _late,
    "dropped": lambda taken, before, frame: taken[frame - (frame > 0 and frame % _DROPPED_EVERY == 0)],
}
"""Faults that change a camera's pictures."""
FAULTS = ("none", "turned", "swapped", *PICTURES)


def with_fault(
    cameras: Sequence[Camera], pictures: Sequence[U8], fault: str, row: int, before: int = 0
) -> tuple[list[Camera], list[U8]]:
    """The cameras and their pictures (F, H, W, 3) with a fault in one of them, or in two that are ``swapped``.

    The first ``before`` pictures are for a late camera alone, and left away.
    """
    cameras, pictures = list(cameras), list(pictures)
    if fault == "turned":
        turn = cv2.Rodrigues(np.radians(_DEGREES) * np.array([0.6, 0.8, 0.0]))[0]
        pose = cameras[row].world_to_camera.copy()
        pose[:3] = turn @ pose[:3]
        cameras[row] = replace(cameras[row], world_to_camera=pose)
    elif fault == "swapped":
        other = row + 1 if row + 1 < len(cameras) else row - 1
        pictures[row], pictures[other] = pictures[other], pictures[row]
    elif fault in PICTURES:
        early, own = pictures[row][:before], pictures[row][before:]
        changed = [PICTURES[fault](own, early, frame) for frame in range(len(own))]
        pictures[row] = np.concatenate([early, np.stack(changed)])
    return cameras, [own[before:] for own in pictures]


def write_faulty(rig: Rig, fault: str, camera: str, folder: Path, frames: range) -> Path:
    """The ``frames`` of a rig in a new folder, with a fault in one camera; a late one shows the three before, too."""
    before = min(_LATE_FRAMES, frames.start)
    taken: list[list[U8]] = [[] for _ in rig.cameras]
    for _, pictures in read_frames(rig, frames.start - before, frames.stop):
        for own, picture in zip(taken, pictures, strict=True):
            own.append(np.asarray(picture if picture.dtype == np.uint8 else np.rint(_shown(picture) * 255), np.uint8))
    row = [each.name for each in rig.cameras].index(camera)
    return write_rig(*with_fault(rig.cameras, [np.stack(own) for own in taken], fault, row, before), folder)


def write_rig(cameras: Sequence[Camera], pictures: Sequence[U8], folder: Path) -> Path:
    """A rig with a video of each camera's pictures (F, H, W, 3)."""
    folder.mkdir(parents=True)
    for camera, own in zip(cameras, pictures, strict=True):
        write_video(folder / f"{camera.name}.mp4", own, 30)
    (folder / "rig.json").write_text(json.dumps(rig_document(cameras)))
    return folder


def rig_document(cameras: Sequence[Camera]) -> dict[str, Any]:
    """What rig.json says of cameras whose videos have their names."""
    records = [_record(camera, f"{camera.name}.mp4") for camera in cameras]
    return {"fps": 30, "pixel_convention": "(0.5,0.5)", "cameras": records}


def _shown(picture: NDArray[np.float32]) -> NDArray[np.float64]:
    return np.asarray(srgb_from_linear(np.clip(picture, 0, 1)), np.float64)


def write_video(path: Path, pictures: U8, fps: float) -> None:
    """Pictures (F, H, W, 3), of even sides, as H.264."""
    with av.open(str(path), "w") as out:
        stream = out.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
        stream.height, stream.width, stream.pix_fmt = *pictures.shape[1:3], "yuv420p"
        stream.options = {"crf": CRF, "preset": "veryfast", "tune": "grain", "threads": "1"}
        for picture in pictures:
            out.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")))
        out.mux(stream.encode())


def _record(camera: Camera, file: str) -> dict[str, Any]:
    model = camera.distortion_model if camera.distortion else "none"
    return {
        "name": camera.name,
        "file": file,
        "width": camera.width,
        "height": camera.height,
        **{name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy")},
        "distortion_model": model,
        "distortion": list(camera.distortion),
        "world_to_camera": camera.world_to_camera.tolist(),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rig")
    parser.add_argument("fault", choices=FAULTS)
    parser.add_argument("camera")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frames", default="3:19", metavar="A:B")
    options = parser.parse_args(arguments)
    rig = open_rig(options.rig)
    first, last = (int(side) for side in options.frames.split(":"))
    write_faulty(rig, options.fault, options.camera, options.folder, range(first, min(last, rig.frame_count)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
