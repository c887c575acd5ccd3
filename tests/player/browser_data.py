"""Streams and the pictures that decogs-decode makes of them, for the player's browser tests (player/tests/browser).

python tests/player/browser_data.py FOLDER [RIG.dgs ...]
"""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.codec.header.presentation import Presentation
from decogs.codec.packets.corrections import ALWAYS_LIT, CorrectedCameras, Correction, LampWave, write_corrections
from decogs.codec.packets.deltas import apply_delta, difference
from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.packets.sound import SoundTrack
from decogs.codec.packets.syntax import write_delta, write_key, write_skip
from decogs.codec.scene.lattice import default_lattice, quantise
from decogs.codec.scene.state import take_rows
from decogs.decoder import open_stream
from decogs.decoder.cameras.moves import looked_at
from decogs.decoder.commands import decode_main
from decogs.formats.cameras import Camera, camera_centre, is_distorted
from decogs.formats.geometry.up_direction import up_of
from decogs.formats.splats import Splats
from decogs.formats.stream.container import PacketKind, StreamWriter

sys.path.insert(0, str(Path(__file__).parents[1]))
from sounding_streams import with_sound

CANARY = Path(__file__).parents[1] / "canary"
POSE = {
    "width": 200,
    "height": 150,
    "fov_y": 50,
    "position": [0.3, -0.2, 0.1],
    "look_at": [0, 0, 2],
    "up": [0.1, -1, 0],
}
SEGMENT = 60
LONG = 300
SHOWN = Presentation(
    title="Three <cameras> & a ball",
    poster=2,
    first_view="off centre",
    # 2.5 times a turn of 40 degrees about z after one of 25 about x.
    transform=(
        (1.915111107797445, -1.456408540173963, 0.679134455685461, 3.0),
        (1.606969024216348, 1.73568011003721, -0.809360927417662, -20.0),
        (0.0, 1.056545654351749, 2.265769467591625, 0.5),
    ),
)
WALL = 1.8
WALL_COLOUR = (0.2, 0.6, 0.4)
"""Of scenes in engines (player/tests/browser/engines.test.mjs): the depth of an opaque wall, display-referred RGB."""
WIDE = 150
"""Frames of a stream of some Mbit/s, for slow links."""


def scene(count: int, degree: int, seed: int) -> Splats:
    """Gaussians of all shapes before the cameras and about them: needles, discs, faint and nearly opaque ones."""
    random = np.random.default_rng(seed)
    values = (
        random.uniform([-1.6, -1.2, 0.2], [1.6, 1.2, 3.5], (count, 3)),
        random.uniform(-6, -1.8, (count, 3)),
        random.normal(size=(count, 4)),
        random.uniform(-4, 5, count),
        random.normal(0, 0.35, (count, (degree + 1) ** 2, 3)),
    )
    return Splats(*(np.ascontiguousarray(value, np.float32) for value in values))


def cameras(near: float = 0.0) -> tuple[Camera, ...]:
    """Three poses, one with a near plane, one with its principal point off the middle; no lens distortion."""
    aside = np.eye(4)
    aside[:3, 3] = [0.2, -0.1, 0.5]
    turned = np.eye(4)
    turned[:3, :3] = [[0.8, 0, -0.6], [0, 1, 0], [0.6, 0, 0.8]]
    return (
        Camera("cam00", 200, 150, 160.0, 160.0, 100.0, 75.0, np.eye(4), near=near),
        Camera("off centre", 180, 140, 130.0, 142.0, 70.0, 80.0, aside),
        Camera("turned", 200, 150, 160.0, 160.0, 100.0, 75.0, turned),
    )


def write_stream(
    path: Path,
    count: int,
    degree: int,
    frames: int,
    *,
    near: float = 0.0,
    subject: bool = False,
    presentation: Presentation = Presentation(),  # noqa: B008 - frozen
) -> list[int]:
    """A tenth of the Gaussians move in every frame, some come and go; a keyframe begins each segment. Packets' ends."""
    lattice = default_lattice(2.0)
    header = StreamHeader(
        cameras=cameras(near),
        lattice=lattice,
        sh_degree=degree,
        fps=30.0,
        background=(0.2, 0.3, 0.5),
        subject=subject,
        presentation=presentation,
    )
    random = np.random.default_rng(7)
    state, _ = keyframe_state(quantise(scene(count, degree, 3), lattice))
    ends = []
    with path.open("wb") as file:
        writer = StreamWriter(file, header.to_bytes())
        for frame in range(frames):
            payload = write_key(state).payload
            if frame:
                rows = np.sort(random.choice(len(state), count // 10, replace=False))
                now = take_rows(state, rows)
                now = replace(now, means=now.means + random.integers(-200, 200, (len(rows), 3), dtype=np.int32))
                young = quantise(scene(3, degree, frame), lattice)
                delta = difference(state, rows, now, removed=rows[:2] if frame % 3 == 0 else None, added=young)
                payload = write_delta(state, delta).payload
                state = apply_delta(state, delta)
                if frame % SEGMENT == 0:
                    payload = write_key(state).payload
            kind = PacketKind.DELTA if frame % SEGMENT else PacketKind.KEY
            writer.write(kind, frame, payload)
            ends.append(file.tell())
        writer.finish()
    return ends


def write_scene_before(path: Path, depth: float) -> None:
    """What of a scene stands before a wall at this depth, over the wall's colour."""
    header = StreamHeader(cameras=cameras(), lattice=default_lattice(2.0), sh_degree=1, background=WALL_COLOUR)
    splats = scene(1500, 1, 3)
    whole = quantise(splats, header.lattice)
    state, _ = keyframe_state(take_rows(whole, np.flatnonzero(splats.means[:, 2] < depth)))
    with path.open("wb") as file:
        writer = StreamWriter(file, header.to_bytes())
        writer.write(PacketKind.KEY, 0, write_key(state).payload)
        writer.finish()


def recording_cameras() -> tuple[Camera, ...]:
    """One of each: a barrel lens with tangential terms, a strong fisheye, one that folds inside its picture, none, and
    one left out."""
    straight, aside, turned = cameras()
    return (
        replace(straight, name="barrel", distortion_model="opencv", distortion=(-0.22, 0.05, 0.003, -0.002)),
        replace(aside, name="fisheye", distortion_model="fisheye", distortion=(0.08, -0.03, 0.01, 0.0)),
        replace(turned, name="folds", distortion_model="opencv", distortion=(-0.9, 0.0, 0.0, 0.0)),
        replace(straight, name="drifts"),
        replace(aside, name="left out"),
    )


def write_recording_stream(path: Path, *, subject: bool = False) -> None:
    """Two frames of a rig whose cameras bend, drift, shake, and have colours and darker borders of their own."""
    corrected = CorrectedCameras(("barrel", "drifts"), ("drifts",), ("fisheye", "drifts"), ("drifts",))
    cells = LampWave(100.0, 0.016, 2, 2, (900, 700, 500, 300, 0, -400) * 2, (0, 200, 400, 600, 800, 1000) * 2)
    alike = LampWave(120.0, -0.012, 1, 1, (700, 600, 500), (-300, 0, 300))
    header = StreamHeader(
        cameras=recording_cameras(),
        lattice=default_lattice(2.0),
        sh_degree=1,
        fps=30.0,
        background=(0.2, 0.3, 0.5),
        effects=("lens_distortion", "colour_mismatch", "lens_falloff", *corrected.effects),
        held_out=("left out",),
        corrected=corrected,
        camera_colours={
            "fisheye": Correction(exposure=-600, red=300, blue=-500, falloff=2500),
            "drifts": Correction(red=200, falloff=3500, lamp=cells),
            "barrel": Correction(falloff=1500, lamp=alike, lamp_amplitude=ALWAYS_LIT),
        },
        subject=subject,
    )
    state, _ = keyframe_state(quantise(scene(1500, 1, 3), header.lattice))
    with path.open("wb") as file:
        writer = StreamWriter(file, header.to_bytes())
        for frame in range(2):
            told = {
                "barrel": Correction(exposure=900 - 1500 * frame),
                "drifts": Correction(
                    *(700, -400, 500 * frame, 3000, -2000, 4000 * frame),
                    lamp_phase=9000 - 20_000 * frame,
                    lamp_amplitude=5000,
                ),
                "fisheye": Correction(yaw=-5000 * frame, roll=2500),
            }
            packet = write_skip(state) if frame else write_key(state)
            kind = PacketKind.SKIP if frame else PacketKind.KEY
            writer.write(kind, frame, write_corrections(told, corrected) + packet.payload)
        writer.finish()


class Pictures:
    """What decogs-decode makes of cameras and frames, and the list of it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.listed: list[dict[str, Any]] = []

    def take(
        self, stream: str, frame: int, camera: str | None, pose: dict[str, Any] = POSE, *, recorded: bool = False
    ) -> None:
        """A view of one frame; ``camera`` None: the free one of ``pose``. ``recorded``: with its lens and colours."""
        name = f"{stream}_{len(self.listed)}.png"
        (self.folder / "pose.json").write_text(json.dumps(pose))
        view = ["--camera", f"{self.folder / 'pose.json'}"] if camera is None else ["--view", camera]
        plain = [] if recorded or camera is None else ["--drift-free", "--undistorted"]
        choice = ["--frames", f"{frame}:{frame + 1}", "--threads", "1"]
        output = ["-o", f"{self.folder / name}"]
        status = decode_main([f"{self.folder / stream}.dgs", *view, *plain, *choice, *output])
        if status:
            raise SystemExit(status)
        told = {"stream": stream, "frame": frame, "camera": camera, "pose": pose, "recorded": recorded, "file": name}
        self.listed.append(told)


def recording(rig: Path) -> list[str]:
    """The cameras of a rig that did more than see the scene."""
    with open_stream(rig) as stream:
        header = stream.header
        return [
            camera.name
            for camera in header.cameras
            if is_distorted(camera) or header.colours_of(camera.name) or header.corrected.of(camera.name)
        ]


def near_to(rig: Path) -> dict[str, Any]:
    """A free camera between the first two of a rig, that looks at what the rig looks at."""
    with open_stream(rig) as stream:
        rig_cameras = stream.header.cameras
        position = (camera_centre(rig_cameras[0]) + camera_centre(rig_cameras[1])) / 2
        target, up = looked_at(rig_cameras), up_of(rig_cameras)
    place = {"position": position.tolist(), "look_at": target.tolist(), "up": up.tolist()}
    return {"width": 320, "height": 200, "fov_y": 50, **place}


def main() -> None:
    folder, *rigs = map(Path, sys.argv[1:])
    folder.mkdir(parents=True, exist_ok=True)
    pictures = Pictures(folder)
    for name in ("arc", "dome", "light"):
        shutil.copy(CANARY / f"{name}.dgs", folder)
        pictures.take(name, 0, "cam00")
    for degree in (1, 2, 3):
        write_stream(folder / f"degree{degree}.dgs", 1500, degree, 4, near=0.6 if degree == 2 else 0.0)
        for camera in ("cam00", "off centre"):
            pictures.take(f"degree{degree}", 3, camera)
        pictures.take(f"degree{degree}", 2, None)
    for name in ("recorded", "recorded_subject"):
        write_recording_stream(folder / f"{name}.dgs", subject=name.endswith("subject"))
        for camera in ("barrel", "fisheye", "folds", "drifts", "left out"):
            for frame in (0, 1):
                pictures.take(name, frame, camera, recorded=True)
        pictures.take(name, 1, "barrel")
    for degree in (0, 3):
        name = f"shown{degree}"
        write_stream(folder / f"{name}.dgs", 1500, degree, 4, presentation=SHOWN, near=0.6)
        for camera in ("cam00", "off centre"):
            pictures.take(name, 3, camera)
        pictures.take(name, 2, None, near_to(folder / f"{name}.dgs"))
    for name, nearer in (("engine", np.inf), ("engine_nearer", WALL)):
        write_scene_before(folder / f"{name}.dgs", nearer)
        pictures.take(name, 0, "cam00")
    write_stream(folder / "subject.dgs", 300, 1, 2, subject=True)
    pictures.take("subject", 1, "cam00")
    write_stream(folder / "wide.dgs", 6000, 1, WIDE)
    ends = write_stream(folder / "long.dgs", 800, 0, LONG)
    with_sound(folder / "long.dgs", folder / "tones.dgs")
    write_stream(folder / "placed.dgs", 300, 0, 40, presentation=SHOWN)
    with_sound(folder / "placed.dgs", folder / "placed.dgs", [SoundTrack(1, position=(0.5, 0.25, 2.0))])
    for frame in (0, 7, 61, 130, 299):
        pictures.take("long", frame, "cam00")
    for rig in rigs:
        shutil.copy(rig, folder / f"{rig.stem}.dgs")
        for frame in (0, 3):
            pictures.take(rig.stem, frame, "cam00")
        pictures.take(rig.stem, 2, None, near_to(rig))
        for camera in recording(rig):
            pictures.take(rig.stem, 3, camera, recorded=True)
    whole = (folder / "long.dgs").read_bytes()
    (folder / "cut.dgs").write_bytes(whole[: ends[100] + 40])
    damaged = bytearray(whole)
    damaged[ends[69] + 60] ^= 0x10
    (folder / "damaged.dgs").write_bytes(damaged)
    (folder / "list.json").write_text(json.dumps({"pictures": pictures.listed, "ends": ends}))


if __name__ == "__main__":
    main()
