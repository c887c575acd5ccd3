"""Writes decoded frames of a stream as one raw file, for tests of the renderer without the player's decoder.

    python player/tests/stand_in/dump.py scene.dgs scene.raw

Layout: u32 length of a JSON text, the text, padding to 4 bytes, then the float32 arrays it names by their offsets.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from decogs.decoder.stream import Stream
from decogs.decoder import open_stream
from decogs.formats.container import PacketKind

KINDS = {PacketKind.KEY: "key", PacketKind.DELTA: "delta", PacketKind.SKIP: "skip"}


def header_of(stream: Stream) -> dict[str, Any]:
    header = stream.header
    cameras = [
        {
            "name": camera.name,
            **{name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy", "near")},
            "distortionModel": camera.distortion_model,
            "distortion": list(camera.distortion),
            "worldToCamera": camera.world_to_camera[:3].tolist(),
        }
        for camera in header.cameras
    ]
    return {
        "cameras": cameras,
        "lattice": {},
        "shDegree": header.sh_degree,
        "fps": header.fps,
        "firstFrame": header.first_frame,
        "background": list(header.background),
        "effects": list(header.effects),
        "heldOut": list(header.held_out),
    }


def main() -> None:
    source, target = map(Path, sys.argv[1:])
    arrays: list[bytes] = []
    frames: list[dict[str, Any]] = []
    at = 0
    with open_stream(source) as stream:
        before: list[np.ndarray[Any, Any]] = []
        for frame in stream.frames():
            splats = frame.splats
            groups = [splats.means, splats.log_scales, splats.quaternions, splats.opacity_logits[:, None]]
            groups.append(splats.sh.reshape(len(splats), -1))
            rows = None
            if before and len(before[0]) == len(splats):
                rows = np.flatnonzero(np.any([np.any(a != b, axis=1) for a, b in zip(groups, before, strict=True)], 0))
            before = groups
            offsets = []
            for group in groups:
                offsets.append(at)
                arrays.append(np.ascontiguousarray(group, np.float32).tobytes())
                at += len(arrays[-1])
            changes = frame.changes
            frames.append(
                {
                    "kind": KINDS[frame.kind] if frame.kind is not None else None,
                    "bytes": frame.packet_bytes,
                    "count": len(splats),
                    "offsets": offsets,
                    "changedRows": None if rows is None else rows.tolist(),
                    "counts": [changes.touched, changes.added, changes.removed],
                }
            )
        text = json.dumps({"header": header_of(stream), "frames": frames}).encode()
    text += b" " * (-len(text) % 4)
    target.write_bytes(np.uint32(len(text)).tobytes() + text + b"".join(arrays))


if __name__ == "__main__":
    main()
