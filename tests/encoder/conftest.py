"""Settings to match the tiny rigs, and encodes of them that the tests share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import decogs.encoder.frame.plan as plan
import decogs.encoder.stream.encoder as stream_encoder
import tiny_rigs
from decogs.bench.methods.threedgstream import BaselineConfig, BaselineTrainer
from decogs.codec.scene.state import State
from decogs.decoder.reading.stream import open_stream
from decogs.encoder import EncodeReport, EncodeSettings, FrameReport
from decogs.encoder.frame.context import Context
from decogs.encoder.frame.encode_frame import Encoded as EncodedFrame
from decogs.encoder.input.imported_keyframe import read_keyframe
from decogs.encoder.methods import FRAME_METHODS
from decogs.encoder.settings.frame import FrameSettings, MaskSettings
from decogs.encoder.settings.keyframe import KeyframeSettings
from decogs.encoder.stream.options import RunOptions
from decogs.encoder.stream.run import encode_stream
from decogs.encoder.training.method import FrameMethod
from decogs.formats.rigs import open_rig
from decogs.rig.pictures.ingest import Ingest

HELD_OUT, LENS, TinyRig = tiny_rigs.HELD_OUT, tiny_rigs.LENS, tiny_rigs.TinyRig
tiny_rig, shared_data = tiny_rigs.tiny_rig, tiny_rigs.shared_data
moving_rig, still_rig, lens_rig = tiny_rigs.moving_rig, tiny_rigs.still_rig, tiny_rigs.lens_rig

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


@pytest.fixture(scope="session")
def tiny_settings() -> EncodeSettings:
    """Everything the encoder does, in as few steps as still do something."""
    return TINY


BRIEF_BASELINE = FrameMethod(
    partial(BaselineTrainer, config=BaselineConfig(cache_iterations=30, spawn_iterations=20)), dense=True
)


@dataclass
class Encoded:
    """One encode and what was seen of it: after every frame, the encoder's own state, all it has of it, and S_t."""

    path: Path
    report: EncodeReport
    states: list[State] = field(default_factory=list)
    frames: list[EncodedFrame] = field(default_factory=list)
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
        "start": 0, "stop": None, "on_keyframe_step": None, "keyframe": None, "resume": False, "kernel": None,
        "context": lambda context: context,
    } | options  # fmt: skip
    opened = open_rig(rig)
    lens = chosen["settings"].corrections.lens
    ingest = Ingest(opened, holdout=chosen["holdout"], scale=chosen["scale"], lens=lens)
    states: list[State] = []
    frames: list[EncodedFrame] = []
    selected: dict[int, np.ndarray] = {}
    select, begin, encode_one = plan.select, stream_encoder.begin_scene, stream_encoder.encode_frame

    def observed(encode: Callable[..., EncodedFrame]) -> Callable[..., EncodedFrame]:
        def and_noted(*arguments: Any) -> EncodedFrame:
            encoded = encode(*arguments)
            states.append(encoded.scene.state)
            frames.append(encoded)
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
        given = {name: chosen[name] for name in ("seed", "threads", "kernel")}
        context = chosen["context"](_brief(Context.of(ingest, chosen["settings"], **given)))
        report = encode_stream(context, output, span, options, resume=chosen["resume"])
    return Encoded(output, report, states, frames, selected)


def _brief(context: Context) -> Context:
    """The dense baseline trains a fifth of its steps: a frame took longer than a whole encode by other methods."""
    return replace(context, method=BRIEF_BASELINE) if context.settings.method == "3dgstream" else context


@pytest.fixture(scope="session")
def encode(tmp_path_factory: pytest.TempPathFactory) -> Encode:
    """``encode(rig, settings=, holdout=, seed=, threads=, scale=, start=, stop=, keyframe=, resume=, output=)``.

    It observes what it runs. ``kernel=``: None is the native one. ``context=``: makes another one of the encode's.
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


@pytest.fixture
def brief_baseline(monkeypatch: pytest.MonkeyPatch) -> None:
    """The commands' dense baseline trains as few steps as that of ``encode``."""
    monkeypatch.setitem(FRAME_METHODS._loaded, "3dgstream", BRIEF_BASELINE)


@pytest.fixture(scope="session")
def still(encode: Encode, still_rig: Path) -> Encoded:
    return encode(still_rig)


@pytest.fixture
def frame_report() -> FrameReport:
    return FrameReport(
        3, "delta", 1234, 5678, 0.062, 31.5, 30.25, {"masks": 0.1, "training": 1.5, "measure": 9.0}, {}, 2.5
    )


@pytest.fixture(params=["emulated", "gpu"])
def backend(request: pytest.FixtureRequest) -> Any:
    """The CUDA backend, emulated and on a GPU."""
    import cuda_cases  # with torch
    from decogs.encoder.backends import cuda

    missing = cuda.missing() if request.param == "gpu" else None
    if missing:
        pytest.skip(f"no GPU to run on: {missing}")
    return cuda_cases.BACKENDS[request.param]
