"""Writes a large stream for the player's figures: a ball of Gaussians that change in every attribute, others at rest.

    python tests/bench/player_stream.py OUT.dgs [--count N] [--changing SHARE] [--degree SH] [--frames N] [--segment N]

So many of those that change come and go besides (0.5 % of them). Keyframes begin segments and refer to the first one.
Then ``node player/tests/bench.mjs OUT.dgs`` times the player's decoder.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.deltas import apply_delta, difference
from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.packets.syntax import write_delta, write_key
from decogs.codec.scene.lattice import default_lattice, quantise
from decogs.codec.scene.state import State, take_rows
from decogs.formats.splats import Splats
from decogs.formats.stream.container import PacketKind, StreamWriter

sys.path.insert(0, str(Path(__file__).parent))
from decode import LEVEL, nudged
from rasterise import front_camera, random_scene

SIZE = (960, 720)
CHURN = 0.005
"""Share of the Gaussians that change which goes with each frame; as many come."""


def scene_of(count: int, degree: int) -> Splats:
    """A random scene whose harmonics are cut to, or filled up to, a degree."""
    scene = random_scene(count, 1)
    sh = np.zeros((count, (degree + 1) ** 2, 3), np.float32)
    kept = min(sh.shape[1], scene.sh.shape[1])
    sh[:, :kept] = scene.sh[:, :kept]
    rng = np.random.default_rng(5)
    sh[:, kept:] = rng.normal(0, 0.05, sh[:, kept:].shape)
    return replace(scene, sh=sh)


def write_stream(path: Path, count: int, changing: float, degree: int, frames: int, segment: int) -> None:
    lattice = default_lattice(2.0)
    state, _ = keyframe_state(quantise(scene_of(count, degree), lattice))
    header = StreamHeader(
        cameras=(front_camera(*SIZE),), lattice=lattice, sh_degree=degree, fps=30.0, background=(1.0, 1.0, 1.0)
    )
    rng, first = np.random.default_rng(3), state
    members = ball(state, changing)
    with path.open("wb") as file:
        writer = StreamWriter(file, header.to_bytes())
        writer.write(PacketKind.KEY, 0, write_key(state, level=LEVEL).payload)
        for frame in range(1, frames):
            rows = np.flatnonzero(np.isin(state.ids, members))
            now = nudged(rng, take_rows(state, rows))
            gone = np.sort(rng.permutation(len(rows))[: int(len(rows) * CHURN)])
            start = state.next_id
            delta = difference(state, rows, now, removed=rows[gone], added=take_rows(now, gone))
            payload = write_delta(state, delta, level=LEVEL).payload
            state = apply_delta(state, delta)
            members = np.concatenate([members, np.arange(start, state.next_id)])
            if segment and frame % segment == 0:
                writer.write(PacketKind.KEY, frame, write_key(state, first=first, level=LEVEL).payload)
            else:
                writer.write(PacketKind.DELTA, frame, payload)
        writer.finish()


def ball(state: State, share: float) -> np.ndarray:
    """Ids of that share of the Gaussians which is nearest to the middle of all."""
    means = state.means.astype(np.float64)
    distances = np.linalg.norm(means - np.median(means, axis=0), axis=1)
    return state.ids[np.argsort(distances, kind="stable")[: int(share * len(state))]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("path", type=Path)
    parser.add_argument("--count", type=int, default=300_000)
    parser.add_argument("--changing", type=float, default=0.1)
    parser.add_argument("--degree", type=int, choices=range(4), default=1)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--segment", type=int, default=30)
    given = parser.parse_args()
    write_stream(given.path, given.count, given.changing, given.degree, given.frames, given.segment)


if __name__ == "__main__":
    main()
