"""Reckons what a long take from many large cameras costs on many machines, from constants that were measured on one.

    python tests/bench/scale.py [--cameras 60] [--size 3840x2160] [--minutes 10] [--machines 1,10,100] [--lost 0]

The take is encoded in parts: the keyframe first, on one machine; then every part, one closed segment or more, goes to
the next machine that is free; at the end the parts are joined. Machines run as many parts side by side as their
processors and their memory allow. docs/long-takes.md has the table.

What is measured and what is not: every constant below names its measurement. A rig of 3840x2160 is six times as large
a picture as any that was measured; costs are taken to go on in proportion to pixels. More than two threads were not
measured: the part of the work that two threads share is taken to be shared by more.
"""

from __future__ import annotations

import argparse
import heapq
from collections.abc import Sequence
from dataclasses import dataclass

GIGA = 1e9

KEYFRAME_SECONDS, KEYFRAME_MEGAPIXEL = 37.0, 132.0
"""CPU-s of a keyframe, `standard`: always, and for each megapixel of one picture, since a step draws one view.

Through 50 CPU-s of `workbench` (352x264) and 218 of 17 views of 1352x1014."""
POINTS_MEGAPIXEL = 0.37
"""CPU-s of the search for first points for each megapixel of all pictures: 8.7 at 17 views of 1352x1014."""
WATCH_MEGAPIXEL = 0.061
"""CPU-s of a later frame for each megapixel of all pictures, whatever moves: masks, selection, effects, commit.

1.43 at 17 views of 1352x1014."""
READ_MEGAPIXEL = 0.024
"""CPU-s for each megapixel of all pictures of a frame, for decoding H.264 and making floats: .59 at 18 cameras."""
TRAIN_MEGAPIXEL = 2.05
"""CPU-s of a later frame's training for each megapixel of one picture: 2.8 at 1352x1014 with 5 % selected.

The most that a larger picture should take: `workbench`, with a fifteenth of the pixels and 9 % selected, takes .8."""
CATCH_UP = 3.4
"""Ordinary frames that a segment's first one takes more: 19.7 s against 4.4 at 1352x1014, 4.0 against 1.06 (2.8) on
`workbench` in segments of 60."""
CROSS_FADE = 10.2
"""Ordinary frames that going over to the next segment takes more, that one's start included: 45 s against 4.4 at
1352x1014. Where the next segment is of the same part, its start is made once (`CATCH_UP`)."""
START_SECONDS, START_MEGAPIXEL = 1.0, 0.17
"""Seconds until a part trains, on one thread: the process; and for each megapixel of all pictures, reading the first
frame, taking the keyframe over and drawing all views. 4.9 s at 17 views of 1352x1014."""
JOIN_SECONDS, JOIN_SECONDS_GIGABYTE = 0.5, 10.0
"""Seconds of `decogs-join`: to start; and for each gigabyte, not measured: what reading and writing may take."""
SECOND_THREAD, SECOND_THREAD_KEYFRAME = 0.85, 0.54
"""How much faster two threads are than one, above one: frames take 1/1.85 of the time, a keyframe 1/1.54 (241 to 156
s)."""
MEMORY_PIXEL, MEMORY_FIXED = 125 + 15 + 36, 0.8e9
"""Bytes of an encode for each pixel of all cameras, with the next frame read ahead and the three up to the next segment
kept, and besides (`memory_limit.py`)."""
FRAME_BYTES = 20_000
"""Of a stream: between 4 kB (2 % of the Gaussians move) and 34 (`panoptic_basketball`)."""
KEYFRAME_BYTES = 400_000


@dataclass(frozen=True)
class Take:
    """What is recorded; ``megabit``: a second of one camera's video. ``segment``: frames of a closed segment."""

    cameras: int = 60
    width: int = 3840
    height: int = 2160
    fps: float = 30.0
    minutes: float = 10.0
    megabit: float = 100.0
    segment: int = 60
    segments_a_part: int = 1

    @property
    def frames(self) -> int:
        return round(self.fps * 60 * self.minutes)

    @property
    def megapixels(self) -> float:
        """Of one picture."""
        return self.width * self.height / 1e6

    @property
    def part_frames(self) -> int:
        return self.segment * self.segments_a_part

    @property
    def memory(self) -> float:
        """Bytes of one encode, an upper estimate."""
        return MEMORY_FIXED + MEMORY_PIXEL * self.cameras * self.megapixels * 1e6

    @property
    def keyframe_cpu(self) -> float:
        every = self.cameras * self.megapixels
        return KEYFRAME_SECONDS + KEYFRAME_MEGAPIXEL * self.megapixels + (POINTS_MEGAPIXEL + READ_MEGAPIXEL) * every

    @property
    def frame_cpu(self) -> float:
        every = self.cameras * self.megapixels
        return (WATCH_MEGAPIXEL + READ_MEGAPIXEL) * every + TRAIN_MEGAPIXEL * self.megapixels

    @property
    def start(self) -> float:
        return START_SECONDS + START_MEGAPIXEL * self.cameras * self.megapixels

    def parts(self) -> list[float]:
        """CPU-s of every part but for its start.

        The last one may be shorter and fades into nothing, and the first segment has nothing to catch up with.
        """
        costs = []
        for first in range(0, self.frames, self.part_frames):
            frames = min(self.part_frames, self.frames - first)
            segments, ends = -(-frames // self.segment), first + frames < self.frames
            catch_ups = (first > 0) * CATCH_UP
            fades = (segments - 1 + ends) * CROSS_FADE
            costs.append((frames + catch_ups + fades) * self.frame_cpu)
        return costs

    def part_bytes(self) -> float:
        """Bytes that a part reads: its frames of all videos, and a second for the first frame and for seeking."""
        second = self.cameras * self.megabit * 1e6 / 8
        return second * (self.part_frames / self.fps + 1)

    @property
    def join_cpu(self) -> float:
        size = self.frames * FRAME_BYTES + len(self.parts()) * KEYFRAME_BYTES
        return JOIN_SECONDS + JOIN_SECONDS_GIGABYTE * size / GIGA


@dataclass(frozen=True)
class Machine:
    """One of the machines; ``threads``: of each part."""

    cores: int = 16
    memory: float = 192e9
    threads: int = 8


def sped_up(threads: int, second: float = SECOND_THREAD) -> float:
    """How much faster a number of threads is than one, by what the ``second`` one brings (Amdahl)."""
    alone = 2 / (1 + second) - 1
    return 1 / (alone + (1 - alone) / threads)


def slots(take: Take, machine: Machine) -> int:
    """Parts that a machine encodes side by side; 0 where not even one fits."""
    return min(machine.cores // machine.threads, int(machine.memory // take.memory))


def finished(parts: Sequence[float], places: int, lost: int = 0) -> float:
    """Seconds until all parts are done, each at the next of so many places that is free.

    ``lost``: so many parts, the first ones, are lost at their end and done again.
    """
    free = [0.0] * places
    for part in [*parts, *parts[:lost]]:
        heapq.heapreplace(free, free[0] + part)
    return max(free)


@dataclass(frozen=True)
class Outcome:
    """Seconds and bytes of a take on some number of machines."""

    wall: float
    cpu: float
    read: float


def keyframe_wall(take: Take, machine: Machine) -> float:
    """Seconds of the keyframe on all processors of a machine."""
    return take.keyframe_cpu / sped_up(machine.cores, SECOND_THREAD_KEYFRAME)


def part_walls(take: Take, machine: Machine) -> list[float]:
    """Seconds of every part, alone on its processors."""
    return [take.start + part / sped_up(machine.threads) for part in take.parts()]


def simulate(take: Take, machine: Machine, machines: int, lost: int = 0) -> Outcome:
    """Encodes the take on so many machines; raises ValueError where a part does not fit into a machine."""
    if not slots(take, machine):
        raise ValueError(f"a part needs {take.memory / GIGA:.0f} GB and {machine.threads} cores; no machine has them")
    parts, walls = take.parts(), part_walls(take, machine)
    wall = keyframe_wall(take, machine) + finished(walls, machines * slots(take, machine), lost) + take.join_cpu
    cpu = take.keyframe_cpu + sum(parts) + sum(parts[:lost]) + (len(parts) + lost) * take.start + take.join_cpu
    return Outcome(wall, cpu, (len(parts) + lost) * take.part_bytes())


def span(seconds: float) -> str:
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{seconds / 60:.1f} min"


def show(take: Take, machine: Machine, counts: Sequence[int], lost: int) -> None:
    parts, memory = take.parts(), take.memory / GIGA
    print(f"{take.cameras} cameras of {take.width}x{take.height}, {take.frames} frames, {len(parts)} parts of ", end="")
    print(f"{take.part_frames} frames; machines of {machine.cores} cores, {machine.threads} threads a part")
    print(f"CPU-s: keyframe {take.keyframe_cpu:.0f}, a later frame {take.frame_cpu:.1f}, a part's start ", end="")
    print(f"{take.start:.0f} and {CATCH_UP * take.frame_cpu:.0f} to catch up, a part {max(parts):.0f}, join ", end="")
    print(
        f"{take.join_cpu:.0f}\na part reads {take.part_bytes() / GIGA:.1f} GB and may take {memory:.0f} GB of memory\n"
    )
    print("| machines | wall time | CPU-hours | against one machine | read in all, GB | read, MB/s |")
    print("|--:|--:|--:|--:|--:|--:|")
    one = simulate(take, machine, 1, lost)
    for machines in counts:
        found = simulate(take, machine, machines, lost)
        gain, rate = one.wall / found.wall, found.read / (found.wall * 1e6)
        row = (str(machines), span(found.wall), f"{found.cpu / 3600:.0f}", f"{gain:.1f} x")
        print(f"| {' | '.join(row)} | {found.read / GIGA:.0f} | {rate:.0f} |")
    keyframe, longest = keyframe_wall(take, machine), max(part_walls(take, machine))
    least = keyframe + longest + take.join_cpu
    print(f"\nNo number of machines is faster than {span(least)}: keyframe {span(keyframe)}, part {span(longest)}.")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cameras", type=int, default=60)
    parser.add_argument("--size", default="3840x2160", help="of every picture (default 3840x2160)")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--fps", type=float, default=30.0)
    parser.add_argument("--megabit", type=float, default=100.0, help="a second of one video (default 100)")
    parser.add_argument("--segment", type=int, default=60, help="frames of a closed segment (default 60)")
    parser.add_argument("--segments", type=int, default=1, help="of a part (default 1)")
    parser.add_argument("--machines", default="1,10,100,1000", help="numbers of machines (default 1,10,100,1000)")
    parser.add_argument("--cores", type=int, default=16, help="of a machine (default 16)")
    parser.add_argument("--memory", type=float, default=192.0, help="of a machine, GB (default 192)")
    parser.add_argument("--threads", type=int, default=8, help="of a part (default 8)")
    parser.add_argument("--lost", type=int, default=0, help="parts that are lost and encoded again (default 0)")
    options = parser.parse_args()
    width, height = (int(number) for number in options.size.split("x"))
    take = Take(
        options.cameras, width, height, options.fps, options.minutes, options.megabit, options.segment, options.segments
    )
    machine = Machine(options.cores, options.memory * GIGA, options.threads)
    show(take, machine, [int(count) for count in options.machines.split(",")], options.lost)


if __name__ == "__main__":
    main()
