"""``--closed``: a segment follows from the first keyframe and its own pictures, whatever came between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decogs.codec.packets.corrections import Correction
from decogs.codec.scene.digest import digest
from decogs.codec.scene.state import ARRAYS
from decogs.decoder.reading.stream import open_stream
from decogs.encoder import CorrectionSettings, EncodeSettings, Switches, Targets
from decogs.encoder.coding.rate_control import with_budget
from decogs.encoder.coding.scene import IDS_PER_SEGMENT
from decogs.encoder.methods.decogs import DecogsTrainer
from decogs.encoder.settings.frame import SignificanceSettings
from decogs.encoder.training.method import FrameInput, FrameMethod, TrainedFrame
from decogs.formats.errors import UsageError
from decogs.formats.splats import empty_splats
from decogs.formats.stream.container import FRAME_KINDS, PacketKind
from encode_rig import encode_rig
from noting_kernel import NotingKernel
from packets import iterate_packets

MOMENTS, OTHERS = (0, 1, 3, 1, 3, 0), (0, 3, 0, 1, 3, 0)
"""Two takes of two segments: the first frame and the second segment are the same, what is between is not."""


def closed(settings: EncodeSettings, **changes: Any) -> EncodeSettings:
    return replace(settings, segment=3, closed=True, **changes)


def remembering(settings: EncodeSettings) -> EncodeSettings:
    """With all that goes from frame to frame: references, refined pixels, motion, effects of a frame."""
    masks = replace(settings.frame.masks, since_trained=True, light_threshold=4.0)
    frame = replace(
        settings.frame,
        masks=masks,
        joint_iterations=20,
        significance=SignificanceSettings(threshold=1.0),
    )
    return replace(settings, frame=frame, detect_per_frame=True)


def drifting(name: str, frame: int) -> Correction:
    """One camera's exposure drifts."""
    return Correction(exposure=100 * frame) if name == "cam01" else Correction()


def of_budget(settings: EncodeSettings) -> EncodeSettings:
    return with_budget(remembering(settings), 1500.0)


def corrected(settings: EncodeSettings) -> EncodeSettings:
    return replace(remembering(settings), corrections=CorrectionSettings(exposure=("cam01",)))


def dense(settings: EncodeSettings) -> EncodeSettings:
    return replace(settings, method="3dgstream")


def plain(settings: EncodeSettings) -> EncodeSettings:
    return settings


def packets(path: Path) -> list[Any]:
    with path.open("rb") as file:
        return [packet for packet in iterate_packets(file) if packet.kind in FRAME_KINDS]


def payloads(path: Path) -> list[bytes]:
    return [packet.payload for packet in packets(path)]


@pytest.fixture(scope="module")
def rig_of(tiny_rig: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    made: dict[tuple[int, ...], Path] = {}

    def rig(moments: Sequence[int]) -> Path:
        key = tuple(moments)
        if key not in made:
            made[key] = tiny_rig.write(tmp_path_factory.mktemp("takes") / "take", frames=key, faults=drifting)
        return made[key]

    return rig


@pytest.fixture(scope="module")
def key(encode: Any, rig_of: Any, tiny_settings: Any) -> Path:
    return encode(rig_of(MOMENTS), settings=tiny_settings, stop=1).path


@pytest.mark.parametrize("kind", [plain, remembering, of_budget, corrected, dense])
def test_a_segment_follows_from_the_first_frame_and_its_own(
    encode: Any, rig_of: Any, key: Path, tiny_settings: Any, tmp_path: Path, kind: Any
) -> None:
    settings = kind(tiny_settings)
    if kind is corrected:
        key = encode(rig_of(MOMENTS), settings=settings, stop=1).path
    one, other = (
        payloads(encode(rig_of(moments), settings=closed(settings), keyframe=key).path) for moments in (MOMENTS, OTHERS)
    )
    assert one[1:3] != other[1:3]
    assert one[3:] == other[3:]
    opened = replace(settings, segment=3)
    one, other = (
        payloads(encode(rig_of(moments), settings=opened, keyframe=key).path) for moments in (MOMENTS, OTHERS)
    )
    assert one[3:] != other[3:], "open segments depend on what came before, or this test shows nothing"


def test_a_segment_shows_its_scene_in_the_views_of_the_one_before(
    encode: Any, rig_of: Any, key: Path, tiny_settings: Any
) -> None:
    """New views for every segment leave holes in the heap: a take's memory grew by 50 kB a frame."""
    kernel = NotingKernel()
    encode(rig_of(MOMENTS), settings=closed(tiny_settings), keyframe=key, kernel=kernel)
    assert kernel.viewed
    assert len(kernel.viewed) == len(set(kernel.viewed)), "one for each camera"


def test_what_is_as_in_the_first_frame_has_its_bits(
    encode: Any, tiny_rig: Any, tiny_settings: Any, tmp_path: Path
) -> None:
    rig = tiny_rig.write(tmp_path / "rig", frames=(0, 1, 0, 3))
    encoded = encode(rig, settings=replace(
        tiny_settings, segment=2, closed=True))  # fmt: skip
    first, _, again, _ = encoded.states
    for name in (*ARRAYS, "ids"):
        np.testing.assert_array_equal(getattr(again, name), getattr(first, name))
    assert packets(encoded.path)[2].kind == PacketKind.KEY


def test_no_id_is_given_twice(encode: Any, rig_of: Any, key: Path, tiny_settings: Any) -> None:
    states = encode(rig_of(MOMENTS), settings=closed(remembering(tiny_settings)), keyframe=key).states
    first = states[0].next_id
    young = [{int(i) for state in states[at] for i in state.ids if i >= first} for at in (slice(3), slice(3, 6))]
    assert all(young), "something is added in either segment"
    assert not young[0] & young[1]


@pytest.mark.parametrize("kind", [remembering, of_budget, corrected])
def test_closed_segments_resume_to_the_same_bytes(
    encode: Any, rig_of: Any, key: Path, tiny_settings: Any, tmp_path: Path, kind: Any
) -> None:
    given = {"settings": closed(kind(tiny_settings)), "keyframe": None if kind is corrected else key}
    whole = encode(rig_of(MOMENTS), **given)
    for frames in (2, 4, 5):
        (tmp_path / "scene.dgs.part").write_bytes(whole.cut_off(frames, 9))
        resumed = encode(rig_of(MOMENTS), output=tmp_path / "scene.dgs", resume=True, **given)
        assert resumed.data == whole.data
        (tmp_path / "scene.dgs").unlink()


def test_threads_make_no_difference(encode: Any, rig_of: Any, key: Path, tiny_settings: Any) -> None:
    settings = closed(remembering(tiny_settings))
    one, three = (encode(rig_of(MOMENTS), settings=settings, keyframe=key, threads=n) for n in (1, 3))
    assert one.data == three.data


class OneRound(DecogsTrainer):
    """Trains a frame once, and gives it up in later rounds."""

    trained = -1

    def train(self, frame: FrameInput, /) -> TrainedFrame:
        again, self.trained = frame.index == self.trained, frame.index
        rows, none = np.zeros(0, np.int64), empty_splats(frame.scene.sh_degree)
        return TrainedFrame(rows, none, rows, none, rejected=True) if again else super().train(frame)


def test_more_rounds_come_nearer(encode: Any, rig_of: Any, key: Path, tiny_settings: Any) -> None:
    given = {"settings": closed(remembering(tiny_settings), cross_fade=0), "keyframe": key}
    three = encode(rig_of(MOMENTS), **given)
    one = encode(rig_of(MOMENTS), **given, context=lambda context: replace(context, method=FrameMethod(OneRound)))
    assert one.report.frames[3].training_psnr < three.report.frames[3].training_psnr
    assert payloads(one.path)[:3] == payloads(three.path)[:3], "rounds are of a segment's first frame only"


def test_streams_without_closed_segments_say_nothing_of_them(moving: Any) -> None:
    with open_stream(moving.path) as stream:
        assert not {"closed", "cross_fade"} & set(stream.header.settings)


def test_every_closed_segment_has_a_rate_control_of_its_own(
    encode: Any, rig_of: Any, key: Path, tiny_settings: Any
) -> None:
    encoded = encode(rig_of(MOMENTS), settings=closed(of_budget(tiny_settings), cross_fade=0), keyframe=key)
    assert [frame.memory.rate.frames for frame in encoded.frames] == [0, 1, 2, 1, 2, 3], "each counts from its start"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "`closed`: say how many frames a segment has, with `segment`"),
        ({"segment": 2, "targets": Targets(time_budget=1.0)}, "`closed`: `time_budget` carries time"),
        ({"segment": 2, "switches": Switches(ablate=["gate"])}, "`closed`: `ablate` gate carries Adam's moments"),
    ],
)
def test_what_does_not_go_with_closed_segments(
    moving_rig: Path, tiny_settings: Any, tmp_path: Path, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        encode_rig(moving_rig, tmp_path / "scene.dgs", remembering(tiny_settings), closed=True, **options)
    assert not list(tmp_path.iterdir())


def test_segments_whose_ids_are_too_far_apart_to_be_listed(
    rig_of: Any, encode: Any, key: Path, tiny_settings: EncodeSettings
) -> None:
    """From the seventeenth segment on, its Gaussians and the first keyframe's are 2^35 ids apart."""
    settings = replace(remembering(tiny_settings), segment=1, closed=True)
    encoded = encode(rig_of((0,) * 16 + (3, 3)), settings=settings, keyframe=key)
    ids = encoded.states[-1].ids
    assert int(ids[-1]) >= 17 * IDS_PER_SEGMENT >= 1 << 35, "it has Gaussians of its own"
    assert int(ids[0]) < IDS_PER_SEGMENT
    with open_stream(encoded.path) as stream:
        assert [digest(frame.state) for frame in stream.frames()] == [digest(state) for state in encoded.states]
        assert digest(next(iter(stream.frames(17))).state) == digest(encoded.states[17])
