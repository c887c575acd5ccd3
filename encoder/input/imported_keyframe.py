"""The keyframe of an earlier stream as the start of another: settings and methods compared from the same first frame.

Chosen: the reconstructed state, the lattice and the cameras' near planes are taken, not the packet's bytes; writing
them again gives the same packet. What would make the comparison unfair, or show a held-out camera to training, is
refused.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.keyframes import new_state
from decogs.codec.scene.lattice import Lattice
from decogs.codec.scene.state import ARRAYS, Attributes, State, all_rows
from decogs.decoder.reading.stream import open_stream
from decogs.formats.cameras import Camera
from decogs.formats.errors import UsageError
from decogs.rig.pictures.ingest import Ingest

_CAMERA_TOLERANCE = 1e-9
"""Relative and absolute: the same calibration read on another machine may differ in the last bits."""


@dataclass(frozen=True)
class KeyframeSource:
    """Where a keyframe comes from: the earlier stream's path and header, and its state after the first frame."""

    path: Path
    header: StreamHeader
    state: State

    @property
    def count(self) -> int:
        """How many Gaussians it has."""
        return len(self.state)

    @property
    def settings(self) -> dict[str, Any]:
        """The earlier encode's settings of the keyframe."""
        return {
            name: self.header.settings[name] for name in ("keyframe", "lattice_scale") if name in self.header.settings
        }

    def refined(self, factor: int) -> KeyframeSource:
        """The same scene on a lattice of ``factor`` times finer steps: what an encode loses by rounding, it shows.

        Raises UsageError when its integers would not fit 32 bits.
        """
        lattice, scene = self.header.lattice, self.state
        finest = np.iinfo(np.int32).max // factor
        if any(np.abs(getattr(scene, name).astype(np.int64)).max(initial=0) > finest for name in ARRAYS):
            self._refuse(f"its scene does not fit a lattice {factor} times as fine", "take a coarser one")
        finer = Lattice(
            lattice.origin,
            (lattice.means[0] / factor, lattice.means[1] / factor, lattice.means[2] / factor),
            *(getattr(lattice, field.name) / factor for field in fields(Lattice)[2:]),
        )
        state = new_state(
            Attributes(*(getattr(all_rows(scene), name) * np.int32(factor) for name in ARRAYS)),
            ids=scene.ids,
            next_id=scene.next_id,
        )
        return replace(self, header=replace(self.header, lattice=finer), state=state)

    def check(self, ingest: Ingest, first_frame: int) -> None:
        """Raises UsageError unless rig, held-out cameras and first frame are those the keyframe was trained on."""
        given = {camera.name: camera for camera in ingest.rig.cameras}
        if [camera.name for camera in self.header.cameras] != list(given):
            self._refuse("its cameras are not this rig's", "give a stream of the same rig")
        for camera in self.header.cameras:
            what = _difference(camera, given[camera.name])
            if what:
                self._refuse(
                    f"the {what} of its camera {camera.name} is not this rig's", "give a stream of the same rig"
                )
        held_out = {view.camera.name for view in ingest.held_out_views}
        if set(self.header.held_out) != held_out:
            self._refuse(
                f"it was trained with {_listed(self.header.held_out)} held out, this encode holds out "
                f"{_listed(held_out)}",
                "use the same `holdout`",
            )
        if self.header.first_frame != first_frame:
            self._refuse(
                f"it begins with frame {self.header.first_frame} of the rig, not {first_frame}",
                f"use `frames` {self.header.first_frame}:",
            )

    def _refuse(self, problem: str, remedy: str) -> None:
        raise UsageError(f"`keyframe` {self.path}: {problem}; {remedy}")


def read_keyframe(path: str | os.PathLike[str]) -> KeyframeSource:
    """The first frame of the stream ``path``; raises UsageError when there is none, StreamError for a damaged one."""
    try:
        with open_stream(path, strict=False) as stream:
            if not stream.frame_count:
                raise UsageError(f"`keyframe` {path}: the stream has no frame; give one with at least a keyframe")
            if stream.header.layers:
                remedy = f"take them off with `decogs-edit {path} -o PLAIN.DGS strip layers`"
                raise UsageError(f"`keyframe` {path}: the stream is in layers; {remedy}")
            return KeyframeSource(Path(path), stream.header, next(stream.frames(0, 1)).state)
    except OSError as error:
        raise UsageError(f"`keyframe` {path}: {error.strerror}; give the .dgs file of an earlier encode") from error


def _difference(one: Camera, other: Camera) -> str:
    """What makes two cameras differ, other than near planes; empty when nothing does."""
    for field in fields(Camera):
        if field.name == "near":
            continue
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, str):
            same = a == b
        else:
            same = np.shape(a) == np.shape(b) and np.allclose(a, b, rtol=_CAMERA_TOLERANCE, atol=_CAMERA_TOLERANCE)
        if not same:
            return {"world_to_camera": "pose"}.get(field.name, field.name.replace("_", " "))
    return ""


def _listed(names: set[str] | tuple[str, ...]) -> str:
    return ", ".join(sorted(names)) or "no camera"
