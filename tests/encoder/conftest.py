"""A tiny rig rendered from known Gaussians, settings to match, and encodes of it that the tests share."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import decogs.encoder.frame.plan as plan
import decogs.encoder.stream.encoder as stream_encoder
from decogs.codec.packets.corrections import Correction
from decogs.codec.scene.state import State
from decogs.decoder.output.pictures import to_8bit
from decogs.decoder.reading.stream import open_stream
from decogs.decoder.rendering.views import render_view
from decogs.encoder import EncodeReport, EncodeSettings, FrameReport
from decogs.encoder.frame.context import Context
from decogs.encoder.frame.encode_frame import Encoded as EncodedFrame
from decogs.encoder.input.imported_keyframe import read_keyframe
from decogs.encoder.settings.frame import FrameSettings, MaskSettings
from decogs.encoder.settings.keyframe import KeyframeSettings
from decogs.encoder.stream.options import RunOptions
from decogs.encoder.stream.run import encode_stream
from decogs.formats.cameras import Camera
from decogs.formats.rigs import open_rig
from decogs.formats.splats import SH_C0, Splats, join_splats
from decogs.rig.pictures.ingest import Ingest

WIDTH, HEIGHT, FRAMES, CAMERAS = 64, 48, 4, 5
HELD_OUT = "cam02"
LENS = (0.12, 0.01, 0.002, -0.003)
"""Pincushion: its undistorted picture has unrecorded corners."""

TINY = EncodeSettings(
    # Without Gaussians beside the pictures (test_border_extrapolation): ten steps are too few for the others to adapt
    # to them.
    keyframe=KeyframeSettings(
        iterations=80, cap=1200, sh_degree=1, grow_every=20, validation_every=20, settle_iterations=10
    ),
    frame=FrameSettings(
        masks=MaskSettings(threshold=10.0),
        joint_iterations=10,
        warm_start=0.9,
    ),
)


def camera(index: int) -> Camera:
    """Cameras on an arc of 60 degrees, 2 units before the origin; x right, y down, z forward."""
    angle = np.radians(-30 + 15 * index)
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    pose[:3, 3] = [0, 0.05 * (-1) ** index, 2]
    return Camera(f"cam{index:02d}", WIDTH, HEIGHT, 55.0, 55.0, WIDTH / 2, HEIGHT / 2, pose)


def patch(centre: tuple[float, float, float], across: int, down: int, spacing: float, seed: int) -> Splats:
    """A textured rectangle of opaque Gaussians that faces the cameras."""
    random = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(across) - (across - 1) / 2, np.arange(down) - (down - 1) / 2)
    count = across * down
    means = np.stack([x.ravel() * spacing, y.ravel() * spacing, np.zeros(count)], axis=1) + centre
    log_scales = np.tile(np.log([0.6 * spacing, 0.6 * spacing, 0.05 * spacing]), (count, 1))
    colours = random.uniform(0.1, 0.9, (count, 1, 3))
    values = (means, log_scales, np.tile([1.0, 0, 0, 0], (count, 1)), np.full(count, 5.0), (colours - 0.5) / SH_C0)
    return Splats(*(np.ascontiguousarray(value, np.float32) for value in values))


def scene_at(frame: int) -> Splats:
    """A wall that stays; before it a square that moves, except from frame 1 to 2; a small one appears in frame 3."""
    place = 0.1 * (0, 1, 1, 2)[frame]
    scene = join_splats(patch((0, 0, 0.5), 56, 34, 0.11, 1), patch((place - 0.1, 0.05, -0.2), 5, 5, 0.08, 2))
    return join_splats(scene, patch((-0.35, -0.2, -0.2), 2, 2, 0.06, 3)) if frame == 3 else scene


@dataclass(frozen=True)
class _Lookup:
    cameras: tuple[Camera, ...]
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    subject: bool = False
    camera_colours: Mapping[str, Correction] = field(default_factory=dict)
    subject: bool = False


class TinyRig:
    """Writes variants of the rig; test modules are imported on their own and cannot import this file."""

    width, height, frames, cameras, held_out = WIDTH, HEIGHT, FRAMES, CAMERAS, HELD_OUT
    names = tuple(f"cam{i:02d}" for i in range(CAMERAS))
    camera = staticmethod(camera)
    patch = staticmethod(patch)
    scene_at = staticmethod(scene_at)

    @staticmethod
    def write(
        folder: Path,
        *,
        cameras: int = CAMERAS,
        frames: Sequence[int] = range(FRAMES),
        noise: float = 0.0,
        lens: tuple[float, ...] = (),
        faults: Callable[[str, int], Correction] | None = None,
    ) -> Path:
        """rig.json with a folder of PNG per camera; ``frames`` are the moments shown, ``noise`` is in 8-bit steps.

        ``faults``: of a camera in a frame, by name and index.
        """
        random = np.random.default_rng(7)
        views = [camera(i) for i in range(cameras)]
        if lens:
            views = [replace(view, distortion_model="opencv", distortion=lens) for view in views]
        for view in views:
            (folder / view.name).mkdir(parents=True)
            for index, moment in enumerate(frames):
                told = None if faults is None else {view.name: faults(view.name, index)}
                seen = render_view(_Lookup((view,)), scene_at(moment), view.name, corrections=told)  # type: ignore[arg-type]
                clean = to_8bit(seen.image)
                noisy = np.clip(np.rint(clean + random.normal(0, noise, clean.shape)), 0, 255).astype(np.uint8)
                TinyRig.write_png(folder / view.name / f"{index:04d}.png", noisy)
        (folder / "rig.json").write_text(json.dumps(TinyRig.values(views)))
        return folder

    @staticmethod
    def values(views: Sequence[Camera]) -> dict[str, Any]:
        return {
            "pixel_convention": "the centre of the top-left pixel is (0.5, 0.5)",
            "fps": 25,
            "source": "rendered for the tests",
            "licence": "CC0-1.0",
            "length_unit": "metre (rendered)",
            "cameras": [
                {
                    "name": view.name,
                    "file": view.name,
                    "width": view.width,
                    "height": view.height,
                    "fx": view.fx,
                    "fy": view.fy,
                    "cx": view.cx,
                    "cy": view.cy,
                    "distortion_model": view.distortion_model,
                    "distortion": list(view.distortion),
                    "world_to_camera": view.world_to_camera.tolist(),
                }
                for view in views
            ],
        }

    @staticmethod
    def write_png(path: Path, picture: np.ndarray) -> None:
        assert cv2.imwrite(str(path), picture[..., ::-1])

    @staticmethod
    def poisoned(rig: Path, copy: Path, name: str) -> Path:
        """A copy in which every picture of one camera is turned upside down and inverted."""
        shutil.copytree(rig, copy)
        for path in (copy / name).iterdir():
            cv2.imwrite(str(path), 255 - cv2.imread(str(path))[::-1])
        return copy


@pytest.fixture(scope="session")
def tiny_rig() -> type[TinyRig]:
    return TinyRig


@pytest.fixture(scope="session")
def tiny_settings() -> EncodeSettings:
    """Everything the encoder does, in as few steps as still do something."""
    return TINY


@pytest.fixture(scope="session")
def moving_rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Motion in frames 1 and 3, nothing new in frame 2, a new object in frame 3."""
    return TinyRig.write(tmp_path_factory.mktemp("rigs") / "moving")


@pytest.fixture(scope="session")
def still_rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One moment again and again, with the sensor noise of the shared synthetic rigs (1.2 steps)."""
    return TinyRig.write(tmp_path_factory.mktemp("rigs") / "still", frames=[0] * FRAMES, noise=1.2)


@pytest.fixture(scope="session")
def lens_rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two frames seen through lenses whose undistorted pictures have unrecorded pixels."""
    return TinyRig.write(tmp_path_factory.mktemp("rigs") / "lens", frames=[0, 1], lens=LENS)


@dataclass
class Encoded:
    """One encode and what was seen of it from outside: the encoder's own state and S_t after every frame."""

    path: Path
    report: EncodeReport
    states: list[State] = field(default_factory=list)
    selected: dict[int, np.ndarray] = field(default_factory=dict)

    @property
    def data(self) -> bytes:
        return self.path.read_bytes()

    def cut_off(self, frames: int, more: int = 0) -> bytes:
        """What an encode that was killed after so many frames, and ``more`` bytes of the next one, has left."""
        with open_stream(self.path) as stream:
            sizes = [frame.packet_bytes for frame in stream.frames()]
        data = self.data
        return data[: data.index(b"DGSP\x02") + sum(sizes[:frames]) + more]


Encode = Callable[..., Encoded]


def _encode(output: Path, rig: Path, **options: Any) -> Encoded:
    chosen: dict[str, Any] = {
        "settings": TINY, "holdout": [HELD_OUT], "seed": 0, "threads": 1, "scale": 1.0, "on_frame": None,
        "start": 0, "stop": None, "on_keyframe_step": None, "keyframe": None, "resume": False,
    } | options  # fmt: skip
    opened = open_rig(rig)
    lens = chosen["settings"].corrections.lens
    ingest = Ingest(opened, holdout=chosen["holdout"], scale=chosen["scale"], lens=lens)
    states: list[State] = []
    selected: dict[int, np.ndarray] = {}
    select, begin, encode_one = plan.select, stream_encoder.begin_scene, stream_encoder.encode_frame

    def observed(encode: Callable[..., EncodedFrame]) -> Callable[..., EncodedFrame]:
        def and_noted(*arguments: Any) -> EncodedFrame:
            encoded = encode(*arguments)
            states.append(encoded.scene.state)
            return encoded

        return and_noted

    def observed_select(*arguments: Any) -> np.ndarray:
        chosen = select(*arguments)
        before = selected.get(len(states))
        # A round of catching up selects among more Gaussians than the frame began with.
        if before is None or len(before) == len(chosen):
            selected[len(states)] = chosen if before is None else before | chosen
        return chosen

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(stream_encoder, "begin_scene", observed(begin))
        patched.setattr(stream_encoder, "encode_frame", observed(encode_one))
        patched.setattr(plan, "select", observed_select)
        options = RunOptions(
            keyframe=None if chosen["keyframe"] is None else read_keyframe(chosen["keyframe"]),
            on_frame=chosen["on_frame"],
            on_keyframe_step=chosen["on_keyframe_step"],
        )
        span = range(chosen["start"], chosen["stop"] or opened.frame_count)
        context = Context.of(ingest, chosen["settings"], seed=chosen["seed"], threads=chosen["threads"])
        report = encode_stream(context, output, span, options, resume=chosen["resume"])
    return Encoded(output, report, states, selected)


@pytest.fixture(scope="session")
def encode(tmp_path_factory: pytest.TempPathFactory) -> Encode:
    """``encode(rig, settings=, holdout=, seed=, threads=, scale=, start=, stop=, keyframe=, resume=, output=)``.

    It observes what it runs.
    """

    def run(rig: Path, *, output: Path | None = None, **options: Any) -> Encoded:
        return _encode(output or tmp_path_factory.mktemp("encoded") / "scene.dgs", rig, **options)

    return run


@pytest.fixture(scope="session")
def moving(encode: Encode, moving_rig: Path) -> Encoded:
    """The moving rig's stream; no test may write to it."""
    return encode(moving_rig)


@pytest.fixture(scope="session")
def dense(encode: Encode, moving_rig: Path, moving: Encoded) -> Encoded:
    """The moving rig's stream by the dense baseline, from the same keyframe."""
    return encode(moving_rig, settings=replace(TINY, method="3dgstream"), keyframe=moving.path)


@pytest.fixture(scope="session")
def still(encode: Encode, still_rig: Path) -> Encoded:
    return encode(still_rig)


@pytest.fixture(scope="session")
def shared_data() -> Callable[[str], Path]:
    """``shared_data("rigs/still")``: that folder of the optional shared data; skips the test where it is absent."""
    root = Path(os.environ.get("DECOGS_SHARED", Path(__file__).resolve().parents[2].parent / "shared")) / "data"

    def find(name: str) -> Path:
        if not (root / name).exists():
            pytest.skip(f"no shared data at {root / name}")
        return root / name

    return find


@pytest.fixture
def frame_report() -> FrameReport:
    return FrameReport(
        3, "delta", 1234, 5678, 0.062, 31.5, 30.25, {"masks": 0.1, "training": 1.5, "measure": 9.0}, {}, 2.5
    )


@pytest.fixture(params=["stand-in", "gsplat"], ids=lambda name: "gsplat-on-a-gpu" if name == "gsplat" else name)
def backend(request: pytest.FixtureRequest) -> Any:
    """The CUDA backend, on the stand-in and on a GPU."""
    import cuda_cases  # with torch
    from decogs.encoder.backends import cuda

    missing = cuda.missing() if request.param == "gsplat" else None
    if missing:
        pytest.skip(f"nothing to run gsplat on: {missing}")
    return cuda_cases.BACKENDS[request.param]
