"""A rig with a flash and a click at the same instant, and where both are in what comes out of it.

python tests/flash_and_click.py prints how far apart they are in the .mp4 of a stream and of its edits.
"""

from __future__ import annotations

import json
import math
import tempfile
from dataclasses import replace
from pathlib import Path

import av
import numpy as np

from decogs.decoder import decode
from decogs.decoder.editing import Concat, Operation, Retime, Speed, Trim, edit
from decogs.encoder import PRESETS, EncodeSettings
from encode_rig import encode_rig
from videos_with_sound import write_video

FPS, FRAMES, FLASH = 25, 24, 12
CAMERAS = 4
WIDTH, HEIGHT = 64, 48
AHEAD = {"cam01": 3, "cam02": 1}
"""Frames by which recordings begin before the others."""
SEGMENTS = {"segment": 5, "closed": True}

EDITS: dict[str, tuple[list[Operation], list[float]]] = {
    "trimmed": ([Trim(slice(7, 20))], [5]),
    "trimmed-to-the-flash": ([Trim(slice(FLASH, 15))], [0]),
    "trimmed-twice": ([Trim(slice(3, 20)), Trim(slice(6, 12))], [3]),
    "slow": ([Retime(speeds=(Speed(0, None, 0.5, 0.5),))], [2 * FLASH]),
    "fast": ([Retime(speeds=(Speed(0, None, 2.0, 2.0),))], [FLASH / 2]),
    "slow-and-fast": ([Retime(speeds=(Speed(0, 8, 0.5, 0.5), Speed(14, None, 3.0, 3.0)))], [FLASH + 8]),
    "held": ([Retime(holds=((4, 9),))], [FLASH + 9]),
    "trimmed-and-slow": ([Trim(slice(8, 18)), Retime(speeds=(Speed(0, None, 0.25, 0.25),))], [16]),
}
"""By name, what is done, and the frames in which it flashes then."""


def few() -> EncodeSettings:
    """A keyframe of few Gaussians: enough to see a flash, and quick."""
    live = PRESETS["live"]
    return replace(live, keyframe=replace(live.keyframe, iterations=60, settle_iterations=30, cap=300))


def write_flashing_rig(folder: Path, *, sound: tuple[str, ...] = ("cam01",)) -> Path:
    """A square that is white in frame FLASH, with a click at its start, in recordings that begin at different times."""
    folder.mkdir(parents=True, exist_ok=True)
    entries = []
    for number in range(CAMERAS):
        name = f"cam{number:02d}"
        ahead = AHEAD.get(name, 0)
        pictures = [picture(number, frame - ahead) for frame in range(FRAMES + ahead)]
        heard = click(FRAMES + ahead, FLASH + ahead) if name in sound else None
        write_video(folder / f"{name}.mp4", np.stack(pictures), heard, fps=FPS)
        entries.append({"name": name, "file": f"{name}.mp4", "start": -ahead, **pose(number)})
    (folder / "rig.json").write_text(json.dumps({"pixel_convention": "(0.5,0.5)", "fps": FPS, "cameras": entries}))
    return folder


def picture(camera: int, frame: int) -> np.ndarray:
    shown = np.random.default_rng(camera).integers(50, 90, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    shown[12:36, 16:48] = 250 if frame == FLASH else (120, 60, 30)
    return shown


def click(frames: int, at: int) -> np.ndarray:
    """Silence, but for a burst that begins with frame ``at``."""
    heard = np.zeros(frames * 48_000 // FPS, np.float32)
    begin = at * 48_000 // FPS
    heard[begin : begin + 400] = 0.8 * np.sin(np.arange(400) * 0.7) * np.exp(-np.arange(400) / 120)
    return heard


def pose(number: int) -> dict[str, object]:
    angle = 0.15 * (number - 1.5)
    turn = np.array([[math.cos(angle), 0, -math.sin(angle)], [0, 1, 0], [math.sin(angle), 0, math.cos(angle)]])
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3], world_to_camera[:3, 3] = turn, (0, 0, 3)
    intrinsics = {"width": WIDTH, "height": HEIGHT, "fx": 70.0, "fy": 70.0, "cx": WIDTH / 2, "cy": HEIGHT / 2}
    return {**intrinsics, "distortion_model": "none", "world_to_camera": world_to_camera.tolist()}


def encoded(rig: Path, output: Path, **fields: object) -> Path:
    """The rig as a stream, with the sound of cam01 unless ``fields`` say otherwise."""
    encode_rig(rig, output, **{"settings": few(), "audio": "cam01", **fields})
    return output


def flash_of(video: Path) -> list[float]:
    """Seconds at which the picture of a video turns bright."""
    with av.open(str(video)) as container:
        frames = [(frame.time, frame.to_ndarray(format="gray").mean()) for frame in container.decode(video=0)]
    levels = np.array([level for _, level in frames])
    is_bright = levels > (levels.min() + levels.max()) / 2
    return [frames[k][0] for k in range(len(frames)) if is_bright[k] and not (k and is_bright[k - 1])]


def clicks_of(file: Path) -> list[float]:
    """Seconds at which clicks begin in the sound of a file: half of the first loudest sample's rise before it."""
    heard, start = samples_of(file)
    return [start + at / 48_000 for at in onsets(heard)]


def samples_of(file: Path) -> tuple[np.ndarray, float]:
    """Samples at 48 kHz, and the time of the first one."""
    parts: list[np.ndarray] = []
    start = None
    with av.open(str(file)) as container:
        resampler = av.AudioResampler(format="fltp", layout="mono", rate=48_000)
        for frame in container.decode(audio=0):
            start = frame.time if start is None else start
            parts += [part.to_ndarray()[0] for part in resampler.resample(frame)]
    return np.concatenate(parts), float(start or 0)


def onsets(heard: np.ndarray) -> list[int]:
    """Samples at which a quarter of the loudest level is reached after a tenth of a second of less."""
    loud = np.flatnonzero(np.abs(heard) > 0.25 * np.abs(heard).max())
    return [int(at) for at, before in zip(loud, [-48_000, *loud[:-1]], strict=True) if at - before > 4_800]


def main() -> None:
    """Prints a row for each way, in milliseconds: how much later the click is than the flash in the .mp4."""
    folder = Path(tempfile.mkdtemp())
    rig = write_flashing_rig(folder / "rig")
    streams = {"encoded": encoded(rig, folder / "scene.dgs"), "in segments": encoded(rig, folder / "s.dgs", **SEGMENTS)}
    for name, (operations, _) in EDITS.items():
        streams[name] = folder / f"{name}.dgs"
        edit(streams["in segments"], streams[name], operations)
    others = {"joined": [Trim(slice(2, 19)), Concat((streams["trimmed"],))], "at 20 a second": [Retime(fps=20.0)]}
    for name, operations in others.items():
        streams[name] = folder / f"{name}.dgs"
        edit(streams["encoded"], streams[name], operations)
    for name, stream in streams.items():
        video = stream.with_suffix(".mp4")
        decode(stream, video, view="cam00")
        apart = [heard - seen for seen, heard in zip(flash_of(video), clicks_of(video), strict=True)]
        print(f"{name:<24}", *(f"{1000 * each:7.3f}" for each in apart))


if __name__ == "__main__":
    main()
