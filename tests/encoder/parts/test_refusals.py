"""Parts and joins that are refused in one line, and manifests from strangers."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decogs.codec.header.header import StreamHeader
from decogs.decoder.reading.stream import open_stream
from decogs.encoder import PRESETS, CorrectionSettings, EffectChoice, EncodeSettings, Targets, join
from decogs.encoder.parts.manifest import Part, made_with, part_frames, read_part
from decogs.encoder.settings.effects import PRESET_EFFECTS
from decogs.encoder.settings.reading import read_settings
from decogs.formats.errors import UsageError
from decogs.formats.stream.container import FRAME_KINDS, MAX_FRAME, PacketKind, StreamWriter
from packets import iterate_packets
from part_takes import Make


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"only": (1, 4)}, "`only` 1:4: a part begins where a segment does, such as at 0 or 2"),
        ({"only": (2, 5)}, "`only` 2:5: a part ends where a segment does, such as at 6"),
        ({"only": (8, 9)}, "`only`: there is no such part; the take has frames 0 to 6"),
        ({"only": (2, 4), "closed": False}, "`only`: parts are made of closed segments; add `segment` and `closed`"),
        ({"only": (2, 4), "resume": True}, "`resume`: a part is encoded whole or not at all"),
        ({"only": (2, 4)}, "`only` 2:4: parts after the first start from its keyframe; make one with `only` 0:1"),
    ],
)
def test_what_is_no_part(make: Make, tmp_path: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        make(tmp_path / "part.dgs", options.pop("only"), **options)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": 3}, "key.dgs: it was begun with seed 0, this encode has 3"),
        ({"holdout": ["cam03"]}, "key.dgs: it was made from other input"),
        ({"segment": 4, "only": (4, 7)}, r"key.dgs: it was begun with segment 2, this encode has 4 \(`segment`\)"),
        ({"targets": Targets(quality=60)}, "key.dgs: it was begun with frame.significance.threshold"),
        ({"frames": slice(0, 6), "only": (4, 6)}, "key.dgs: it is a part of frames 0 to 6, not of frames 0 to 5"),
        ({"effects": EffectChoice("none", {"motion"})}, "key.dgs: it was begun with other effects"),
        ({"effects": EffectChoice("none", set(PRESET_EFFECTS))}, "key.dgs: it was begun with other effects"),
    ],
)
def test_parts_have_the_options_of_their_keyframe(
    make: Make, key: Path, tmp_path: Path, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        make(tmp_path / "part.dgs", options.pop("only", (4, 7)), keyframe=key, **options)
    assert not list(tmp_path.iterdir())


def test_parts_have_the_pictures_and_releases_of_their_keyframe(
    make: Make, rig: Path, key: Path, tiny_rig: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = tiny_rig.poisoned(rig, tmp_path / "rig", "cam03")
    with pytest.raises(UsageError, match="it was made from other input: the picture content of frame 0 differs"):
        make(tmp_path / "part.dgs", (4, 7), keyframe=key, rig=other)
    monkeypatch.setattr(np, "__version__", "1.0")
    with pytest.raises(UsageError, match=rf"it was made with numpy {np.version.version}, not 1.0"):
        make(tmp_path / "part.dgs", (4, 7), keyframe=key)


@pytest.mark.parametrize(
    "change", [{"effects": ("motion",)}, {"detect_per_frame": False}, {"corrections": CorrectionSettings()}]
)
def test_parts_have_the_effects_of_their_keyframe(
    make: Make, settings: EncodeSettings, key: Path, tmp_path: Path, change: dict[str, Any]
) -> None:
    """Where the settings say which, and nothing is detected."""
    message = "key.dgs: it was begun with (effects|detect_per_frame|corrections)"
    with pytest.raises(UsageError, match=message):
        make(tmp_path / "part.dgs", (4, 7), keyframe=key, settings=replace(settings, **change))


def test_parts_have_the_device_of_their_keyframe() -> None:
    """Since a GPU gives other bits; "auto" is the processor."""
    cpu, auto, cuda = (Part(range(2), range(4), {}, "", made_with(device)) for device in ("cpu", "auto", "cuda"))
    assert cpu.difference(auto) == ""
    assert cpu.difference(cuda) == "it was made with device cpu, not cuda"


def cut(path: Path, copy: Path, change: Callable[[bytearray], Any]) -> Path:
    data = bytearray(path.read_bytes())
    change(data)
    copy.write_bytes(data)
    return copy


def test_lost_and_doubled_parts_are_named(parts: list[Path], tmp_path: Path) -> None:
    for given, message in (
        (parts[1:], "`parts`: none of them has frames 0 to 1; encode a part with `only` 0:2"),
        (parts[:2], "`parts`: none of them has frames 4 to 6; encode a part with `only` 4:7"),
        ([parts[0], parts[2]], "`parts`: none of them has frames 2 to 3"),
        (
            [*parts, parts[1]],
            "2-4.dgs: it has frames 2 to 3, which .*2-4.dgs has as well; leave out one of the two",
        ),
    ):
        refused(given, tmp_path, message)


def test_damaged_parts_are_named(parts: list[Path], tmp_path: Path) -> None:
    with parts[1].open("rb") as file:
        own = next(p for p in iterate_packets(file) if p.kind == PacketKind.KEY and p.frame == 1)

    def flip(data: bytearray) -> None:
        data[own.offset + 40] ^= 1

    def shorten(data: bytearray) -> None:
        del data[own.offset + own.size :]

    for change in (flip, shorten, lambda data: data.__setitem__(slice(5, 6), b"!")):
        damaged = cut(parts[1], tmp_path / "damaged.dgs", change)
        refused([parts[0], damaged, parts[2]], tmp_path, r"damaged.dgs: the part is damaged \(.*\); encode it again")
        damaged.unlink()


def rewritten(
    path: Path, copy: Path, *, frames: Sequence[int] | None = None, first: Callable[[bytes], bytes] = bytes
) -> Path:
    """A part as a whole stream, with other ``frames`` in its manifest or another ``first`` keyframe."""
    with path.open("rb") as file, copy.open("wb") as other:
        header, *packets = iterate_packets(file)
        known = StreamHeader.from_bytes(header.payload)
        manifest = known.settings["part"] | ({} if frames is None else {"frames": list(frames)})
        writer = StreamWriter(other, replace(known, settings={**known.settings, "part": manifest}).to_bytes())
        for packet in packets:
            if packet.kind in FRAME_KINDS:
                writer.write(packet.kind, packet.frame, packet.payload if packet.frame else first(packet.payload))
        writer.finish()
    return copy


@pytest.mark.parametrize(
    ("given", "frames", "problem"),
    [
        (1, (2, 6), "3 of its 5 frame packets are there"),
        (1, (2, 3), "3 of its 2 frame packets are there"),
        (0, (1, 2), "it does not begin with a keyframe"),
    ],
)
def test_parts_that_are_not_what_their_manifest_says_are_named(
    parts: list[Path], tmp_path: Path, given: int, frames: tuple[int, int], problem: str
) -> None:
    other = rewritten(parts[given], tmp_path / "other.dgs", frames=frames)
    refused([other], tmp_path, rf"other.dgs: the part is damaged \({problem}\); encode it again")


@pytest.mark.parametrize("frame", [0, 2, MAX_FRAME])
def test_metrics_of_another_frame_are_named(parts: list[Path], tmp_path: Path, frame: int) -> None:
    """Behind the part's frame 1; the last one would have a number that no packet has in the joined stream."""
    with parts[1].open("rb") as file, (tmp_path / "other.dgs").open("wb") as other:
        header, key, mine, *_ = iterate_packets(file)
        writer = StreamWriter(other, header.payload)
        for packet, number in ((key, 0), (mine, 1)):
            writer.write(packet.kind, number, packet.payload)
        writer.write(PacketKind.METRICS, frame, b"{}")
    problem = f"frame {frame} where frame 1 must come"
    refused([tmp_path / "other.dgs"], tmp_path, rf"other.dgs: the part is damaged \({problem}.*\); encode it again")


def test_parts_that_begin_with_other_keyframes_are_named(parts: list[Path], tmp_path: Path) -> None:
    """As a GPU trains them, other ones every time: all else is the same."""
    other = rewritten(parts[1], tmp_path / "other.dgs", first=lambda payload: payload[:-1] + b"!")
    refused([parts[0], other, parts[2]], tmp_path, "other.dgs: it does not .*: it starts from another first keyframe")


def test_foreign_parts_are_named(
    make: Make, whole: Path, parts: list[Path], rig: Path, settings: EncodeSettings, tiny_rig: Any, tmp_path: Path
) -> None:
    own = tmp_path / "own"
    own.mkdir()
    foreign = {
        "seed": (make(own / "seed.dgs", (0, 2), seed=1), "was begun with seed 1, the other part has 0"),
        "take": (
            make(own / "take.dgs", (0, 2), frames=slice(0, 6)),
            "it is a part of frames 0 to 5, not of frames 0 to 6",
        ),
        "metrics": (make(own / "metrics.dgs", (0, 2), metrics=True), "it was made with `metrics`"),
        "rig": (
            make(own / "rig.dgs", (0, 2), rig=tiny_rig.poisoned(rig, own / "rig", "cam03")),
            "it was made from other input: the picture content of frame 0 differs",
        ),
    }
    for name, (path, problem) in foreign.items():
        refused(
            [parts[1], path, parts[2]], tmp_path / "out", rf"{name}.dgs: it does not belong to .*2-4.dgs: {problem}"
        )
    refused([whole, *parts], tmp_path / "out", "scene.dgs: this is no part of a take")
    refused([tmp_path / "none.dgs"], tmp_path / "out", "none.dgs: No such file or directory")


def refused(parts: Sequence[Path], folder: Path, message: str) -> None:
    folder.mkdir(exist_ok=True)
    before = sorted(folder.iterdir())
    with pytest.raises(UsageError, match=message) as raised:
        join(parts, folder / "joined.dgs")
    assert "\n" not in str(raised.value)
    assert sorted(folder.iterdir()) == before


def test_a_part_is_never_written_over(parts: list[Path], tmp_path: Path) -> None:
    copies = [Path(shutil.copy(path, tmp_path)) for path in parts]
    with pytest.raises(UsageError, match="is read, as one of the parts"):
        join(copies, copies[1])
    assert copies[1].read_bytes() == parts[1].read_bytes()


# Manifest and settings


@pytest.mark.parametrize(
    "spoil",
    [
        lambda part: None,
        lambda part: [],
        lambda part: {},
        lambda part: part | {"frames": [4, 2]},
        lambda part: part | {"frames": [2, 4.5]},
        lambda part: part | {"frames": [2, 1 << 40]},
        lambda part: part | {"take": [0, 3]},
        lambda part: part | {"take": [1, 7]},
        lambda part: part | {"take": "0:7"},
        lambda part: part | {"inputs": {"a": 1}},
        lambda part: part | {"made_with": None},
        lambda part: part | {"recorded": 3},
        lambda part: part | {"metrics": 1},
    ],
)
def test_manifests_from_strangers(parts: list[Path], spoil: Callable[[Any], Any]) -> None:
    with open_stream(parts[1]) as stream:
        header = stream.header
    assert read_part(header) is not None
    spoilt = replace(header, settings={**header.settings, "part": spoil(header.settings["part"])})
    assert read_part(spoilt) is None


def test_negative_and_open_ends(tmp_path: Path) -> None:
    assert part_frames(slice(-3, None), range(7), 2) == range(4, 7)
    assert part_frames(slice(13, None), range(3, 20), 5) == range(13, 20)


@pytest.mark.parametrize("name", list(PRESETS))
def test_settings_are_read_as_they_were_written(name: str) -> None:
    corrections = CorrectionSettings(exposure=("a", "b"), lens={"a": 0.1}, match_colours=True)
    written = replace(PRESETS[name], segment=5, closed=True, corrections=corrections, effects=("motion",))
    assert read_settings(written.as_document() | {"seed": 3}) == written


def test_what_the_keyframe_cost_is_not_paid_again(
    make: Make, settings: EncodeSettings, key: Path, tmp_path: Path
) -> None:
    """It does not matter to a part with what settings it would have been trained."""
    other = replace(settings, keyframe=replace(settings.keyframe, iterations=300), lattice_scale=2.0)
    made = [make(tmp_path / f"{n}.dgs", (6, 7), keyframe=key, settings=s) for n, s in enumerate((settings, other))]
    assert made[0].read_bytes() == made[1].read_bytes()
