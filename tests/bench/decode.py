"""Measures decoding: a delta frame from bytes to a checked state, opening a file, and playing a fixed view.

    python tests/bench/decode.py [STREAM.dgs] [--view CAMERA] [--rounds N]

Deltas: one thread, process time, the median over N frames that follow each other, digest check included; every
attribute group of 10 000 out of 100 000 Gaussians changes. Playing: wall time of ``PlayedView`` against
``render_view``, frame by frame in turn, with all processors; equal pixels are asserted. Without a STREAM, a cluster
that moves among 50 000 Gaussians at rest is played at 1352x1014.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from statistics import mean, median
from typing import TypeVar

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.deltas import apply_delta, difference
from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.packets.syntax import write_delta, write_key
from decogs.codec.reconstruct import reconstruct
from decogs.codec.scene.lattice import default_lattice, quantise
from decogs.codec.scene.state import Attributes, State, take_rows
from decogs.decoder import DecodedFrame, Stream, open_stream, render_view
from decogs.decoder.rasterise import Rendering
from decogs.decoder.rendering.played_view import PlayedView
from decogs.formats.stream.container import Packet, PacketKind, StreamWriter

sys.path.insert(0, str(Path(__file__).parent))
from rasterise import front_camera, random_scene

COUNT, TOUCHED, CHURN = 100_000, 10_000, 300
"""Of the delta frames: Gaussians, how many of them change, how many are removed and added besides where any are."""
PLAYED_COUNT, PLAYED_SIZE, PLAYED_FRAMES = 50_000, (1352, 1014), 20
CLUSTER, CLUSTER_RADIUS = (0.2, 0.1, -0.3), 0.35
"""Of the synthetic stream: the Gaussians this near to this point move together (about 2 %)."""
Result = TypeVar("Result")
LEVEL = 3
"""zstd's, for what only serves to be read again."""


def random_attributes(rng: np.random.Generator, count: int, coefficients: int) -> Attributes:
    shapes = ((3,), (3,), (4,), (), (coefficients, 3))
    return Attributes(*(rng.integers(-300, 301, (count, *shape), np.int32) for shape in shapes))


def nudged(rng: np.random.Generator, values: Attributes) -> Attributes:
    """Every integer a few steps on: residuals of both signs, as training leaves them."""
    arrays = (values.means, values.log_scales, values.quaternions, values.opacity_logits, values.sh)
    return Attributes(*(a + np.rint(rng.laplace(0, 4, a.shape)).astype(np.int32) for a in arrays))


def delta_packets(state: State, churn: int, frames: int) -> Iterator[Packet]:
    """Frames that follow ``state``, each with other rows."""
    rng = np.random.default_rng(2)
    for _ in range(frames):
        rows = np.sort(rng.permutation(len(state))[:TOUCHED])
        delta = difference(
            state,
            rows,
            nudged(rng, take_rows(state, rows)),
            removed=rng.permutation(len(state))[:churn],
            added=random_attributes(rng, churn, state.coefficients),
        )
        payload = write_delta(state, delta, level=LEVEL).payload
        state = apply_delta(state, delta)
        yield Packet(PacketKind.DELTA, state.frame, payload)


def milliseconds_of(clock: Callable[[], float], step: Callable[[], Result]) -> tuple[float, Result]:
    start = clock()
    result = step()
    return 1000 * (clock() - start), result


def bench_deltas(frames: int) -> None:
    print(f"Delta frames: {TOUCHED} of {COUNT} Gaussians, all groups, ms of one core, {frames} frames")
    print(f"{'SH degree':>9}  {'removed and added':>17}  {'bytes':>7}  {'median':>6}  {'least':>6}")
    camera = front_camera(64, 48)
    for churn in (0, CHURN):
        for degree in (0, 1, 3):
            header = StreamHeader(cameras=(camera,), lattice=default_lattice(2.0), sh_degree=degree)
            attributes = random_attributes(np.random.default_rng(1), COUNT, (degree + 1) ** 2)
            state, _ = keyframe_state(attributes)
            packets, taken = list(delta_packets(state, churn, frames)), []
            for packet in packets:
                spent, state = milliseconds_of(time.process_time, partial(reconstruct, state, packet, header))
                taken.append(spent)
            size = mean(len(packet.payload) for packet in packets)
            print(f"{degree:9}  {churn:17}  {size:7.0f}  {median(taken):6.2f}  {min(taken):6.2f}")


def moving_cluster(path: Path) -> Path:
    """A stream in which a ball of Gaussians swings among others that rest; 0.5 % of it comes and goes each time."""
    camera, lattice = front_camera(*PLAYED_SIZE), default_lattice(2.0)
    state, _ = keyframe_state(quantise(random_scene(PLAYED_COUNT, 1), lattice))
    header = StreamHeader(cameras=(camera,), lattice=lattice, sh_degree=1, background=(1.0, 1.0, 1.0))
    rng = np.random.default_rng(3)
    centre, step = np.asarray(CLUSTER) / lattice.means, np.asarray(lattice.means)
    members = state.ids[np.linalg.norm((state.means - centre) * step, axis=1) < CLUSTER_RADIUS]
    with path.open("wb") as file:
        writer = StreamWriter(file, header.to_bytes())
        writer.write(PacketKind.KEY, 0, write_key(state, level=LEVEL).payload)
        for frame in range(1, PLAYED_FRAMES):
            rows = np.flatnonzero(np.isin(state.ids, members))
            now = take_rows(state, rows)
            swing = np.rint(0.02 * np.cos(frame / 3) / step).astype(np.int32)
            moved = Attributes(now.means + swing, now.log_scales, now.quaternions, now.opacity_logits, now.sh)
            gone = rng.permutation(len(rows))[: len(rows) // 200]
            first = state.next_id
            delta = difference(state, rows, moved, removed=rows[gone], added=take_rows(moved, gone))
            writer.write(PacketKind.DELTA, frame, write_delta(state, delta, level=LEVEL).payload)
            state = apply_delta(state, delta)
            members = np.concatenate([members, np.arange(first, state.next_id)])
        writer.finish()
    return path


def bench_opening(path: Path, rounds: int) -> None:
    def opened() -> None:
        with open_stream(path):
            pass

    taken = [milliseconds_of(time.process_time, opened)[0] for _ in range(rounds)]
    print(f"\nOpening {path.name}, {path.stat().st_size} bytes: {median(taken):.2f} ms, header and index only")


def whole_picture(stream: Stream, frame: DecodedFrame, name: str) -> Rendering:
    """The picture of all of the frame's Gaussians, which are dequantised for it."""
    return render_view(stream.header, frame.splats, name)


def bench_playing(stream: Stream, name: str) -> None:
    """Both ways to every frame's picture in turn, its state decoded before; the first one, a keyframe, is left out."""
    view, played, whole, shares = PlayedView(stream.header, name), [], [], []
    for frame in stream.frames():
        spent, seen = milliseconds_of(time.perf_counter, partial(view.show, frame))
        dense, expected = milliseconds_of(time.perf_counter, partial(whole_picture, stream, frame, name))
        for part in ("image", "alpha", "depth"):
            assert np.array_equal(getattr(seen, part), getattr(expected, part)), f"frame {frame.index}: {part} differs"
        if frame.index == 0:
            height, width = seen.alpha.shape
            tiles = view.redrawn
            continue
        played.append(spent)
        whole.append(dense)
        shares.append(view.redrawn / tiles)
    scene = f"{width}x{height}, {len(frame.state)} Gaussians, {len(played)} frames"
    print(f"\nPlaying {name} of {stream.path.name}, {scene}; {100 * mean(shares):.0f} % of the tiles touched")
    for label, taken in (("only what changed", played), ("whole pictures", whole)):
        print(f"{label:18}  {1000 / mean(taken):6.1f} frames per second  {mean(taken):7.1f} ms")
    print(f"{mean(whole) / mean(played):.1f} times as fast, every pixel equal")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stream", nargs="?", type=Path, help="the stream to play; a synthetic one by default")
    parser.add_argument("--view", help="the rig camera to play (default: the stream's first)")
    parser.add_argument("--rounds", type=int, default=51, help="delta frames and openings (default 51)")
    options = parser.parse_args()
    print(f"{os.cpu_count()} processors, load average {os.getloadavg()[0]:.1f}\n")
    bench_deltas(options.rounds)
    with tempfile.TemporaryDirectory() as folder:
        path = options.stream or moving_cluster(Path(folder) / "cluster.dgs")
        bench_opening(path, options.rounds)
        with open_stream(path) as stream:
            bench_playing(stream, options.view or stream.header.cameras[0].name)


if __name__ == "__main__":
    main()
