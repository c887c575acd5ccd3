"""The manifest of a part: which frames it holds of which take, what it was made from, and with what."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import zstandard

from decogs.codec.header.header import StreamHeader
from decogs.formats.errors import UsageError
from decogs.formats.frames.ranges import Frames, frame_slice, frames_text
from decogs.formats.rigs import Rig, files_with
from decogs.rig.pictures.ingest import RigFrame

from ..settings.encode import EncodeSettings

_PART_SETTING = "part"


@dataclass(frozen=True)
class Part:
    """``frames``: the rig's frames of the part; ``take``: those of the whole stream.

    ``inputs``: digests of what all parts of a take are made from, by what was digested; ``recorded``: one of the files
    that the part reads frames from. ``made_with``: the device, and the releases on which bits depend, by name.
    ``metrics``: whether each frame's PSNR is behind it.
    """

    frames: range
    take: range
    inputs: Mapping[str, str]
    recorded: str
    made_with: Mapping[str, str]
    metrics: bool = False

    @property
    def start(self) -> int:
        """Place of its first frame in the whole stream."""
        return self.frames.start - self.take.start

    @property
    def packets(self) -> int:
        """Frame packets of its file: its frames, and the first keyframe if that is none of them."""
        return len(self.frames) + (self.start > 0)

    def frame_in_part(self, frame: int) -> int:
        """Where the whole stream's ``frame`` is in the part's file, which begins with the first keyframe."""
        return frame - max(0, self.start - 1) if frame else 0

    def frame_in_stream(self, frame: int) -> int:
        """Where the part file's ``frame`` is in the whole stream."""
        return frame + max(0, self.start - 1) if frame else 0

    def difference(self, other: Part) -> str:
        """What makes two parts belong to different encodes: a few words; empty if nothing does."""
        if self.take != other.take:
            return f"it is a part of {frames_text(self.take)}, not of {frames_text(other.take)}"
        changed = [name for name in {**self.inputs, **other.inputs} if self.inputs.get(name) != other.inputs.get(name)]
        if changed:
            return f"it was made from other input: the {changed[0]} differs"
        for name in {**self.made_with, **other.made_with}:
            mine, theirs = self.made_with.get(name, "none"), other.made_with.get(name, "none")
            if mine != theirs:
                return f"it was made with {name} {mine}, not {theirs}"
        if self.metrics != other.metrics:
            return f"it was made {'with' if self.metrics else 'without'} `metrics`"
        return ""


def part_frames(only: Frames, take: range, segment: int) -> range:
    """The rig's frames of a part of ``take``; raises UsageError unless it is made of whole segments, or a keyframe."""
    within = frame_slice(only, "only")
    frames = range(take.stop)[within]
    asked = f"`only` {frames.start}:{frames.stop}"
    if not len(frames) or frames.step != 1 or frames.start < take.start:
        raise UsageError(f"`only`: there is no such part; the take has {frames_text(take)}")
    before = (frames.start - take.start) // segment * segment + take.start
    if frames.start != before:
        raise UsageError(f"{asked}: a part begins where a segment does, such as at {before} or {before + segment}")
    is_keyframe = frames == range(take.start, take.start + 1)
    if (frames.stop - take.start) % segment and frames.stop != take.stop and not is_keyframe:
        end = min(take.stop, (frames.stop - take.start) // segment * segment + segment + take.start)
        raise UsageError(f"{asked}: a part ends where a segment does, such as at {end}")
    return frames


def frames_read(frames: range, take: range, settings: EncodeSettings) -> range:
    """The frames that a part of ``frames`` is made from: with a cross-fade, the next segment's first one as well."""
    fades = settings.fading > 0 and (frames.stop - take.start) % settings.segment == 0
    return range(frames.start, min(frames.stop + fades, take.stop))


def inputs_of(rig: Rig, first: RigFrame) -> dict[str, str]:
    """Digests of what all parts are made from: the list of cameras and recordings, the first frame's pictures.

    The pictures are digested as they are decoded, so that another video decoder shows as well.
    """
    sources = [
        [camera.name, source.path.name, source.width, source.height, source.frame_count]
        for camera, source in zip(rig.cameras, rig.sources, strict=True)
    ]
    pictures = sorted(first.recorded.items())
    return {"list of recordings": _digest(sources), f"picture content of frame {first.index}": _digest(pictures)}


def recorded(rig: Rig, frames: range) -> str:
    """A digest of the names and sizes in bytes of the files that hold these frames; nothing is decoded for it."""
    return _digest([[path.name, path.stat().st_size] for path in files_with(rig, frames)])


def _digest(values: Any) -> str:
    return hashlib.sha256(json.dumps(values).encode()).hexdigest()[:32]


def made_with(device: str) -> dict[str, str]:
    """The device and the releases on which an encode's bits may depend (SPEC.md, section 11)."""
    return {
        "device": "cuda" if device == "cuda" else "cpu",
        "machine": platform.machine(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "zstd": ".".join(map(str, zstandard.ZSTD_VERSION)),
    }


def with_part(header: bytes, part: Part) -> bytes:
    """A header's payload with the part's manifest among its settings."""
    document = {
        "frames": [part.frames.start, part.frames.stop],
        "take": [part.take.start, part.take.stop],
        "inputs": dict(part.inputs),
        "recorded": part.recorded,
        "made_with": dict(part.made_with),
        "metrics": part.metrics,
    }
    parsed = StreamHeader.from_bytes(header)
    return replace(parsed, settings={**parsed.settings, _PART_SETTING: document}).to_bytes()


def without_part(header: StreamHeader) -> StreamHeader:
    """The header of the whole stream."""
    return replace(header, settings={name: value for name, value in header.settings.items() if name != _PART_SETTING})


def read_part(header: StreamHeader) -> Part | None:
    """The manifest in a part's header; None for a stream that is no part, or has a manifest that says nothing."""
    document = header.settings.get(_PART_SETTING)
    if not isinstance(document, dict):
        return None
    frames, take = _range(document.get("frames")), _range(document.get("take"))
    inputs, tools = _texts(document.get("inputs")), _texts(document.get("made_with"))
    files, metrics = document.get("recorded"), document.get("metrics")
    if frames is None or take is None or inputs is None or tools is None:
        return None
    if not (isinstance(files, str) and isinstance(metrics, bool)):
        return None
    if not (take.start == header.first_frame and take.start <= frames.start and frames.stop <= take.stop):
        return None
    return Part(frames, take, inputs, files, tools, metrics)


def _range(value: Any) -> range | None:
    if not (isinstance(value, list) and len(value) == 2 and all(type(number) is int for number in value)):
        return None
    return range(*value) if 0 <= value[0] < value[1] < 1 << 32 else None


def _texts(value: Any) -> dict[str, str] | None:
    if not (isinstance(value, dict) and all(isinstance(text, str) for text in value.values())):
        return None
    return value
