/** Which blocks one decoder runs through, and where they are heard. */
import type { SoundFrame } from "../scene";
import { BLOCK, CONTINUES, frameStart, PRE_ROLL } from "../container/sound";

/** Blocks without a gap, from the sample `first` on, that are heard from one sample up to, not including, another. */
export interface Run {
  first: number;
  readonly from: number;
  to: number;
  readonly blocks: Uint8Array<ArrayBuffer>[];
}

/** The runs of a track in frames that follow each other. */
export function runsOf(frames: readonly SoundFrame[], track: number, fps: number): Run[] {
  const runs: Run[] = [];
  for (const { frame, packets } of frames) {
    const [begin, end] = [frameStart(frame, fps), frameStart(frame + 1, fps)];
    for (const packet of packets) {
      if (packet.track !== track) continue;
      const at = begin + packet.offset;
      let run = runs.at(-1);
      if (run === undefined || Math.abs(run.to - at) > CONTINUES) {
        if (run !== undefined) run.to = Math.min(run.to, begin);
        if (run?.from === begin) runs.pop(); // of several that begin in a frame the last alone is heard
        runs.push((run = { first: at, from: begin, to: at, blocks: [] }));
      }
      for (const block of packet.blocks) {
        if (run.to >= end) break;
        run.to += BLOCK;
        if (run.to <= begin - PRE_ROLL && run.blocks.length === 0) run.first = run.to;
        else run.blocks.push(block);
      }
    }
  }
  return runs.filter(({ blocks }) => blocks.length > 0);
}

/** Adds a run's samples to those of a piece that begins with sample `start`, where the run is heard. */
export function put(piece: Float32Array, start: number, run: Run, samples: Float32Array): void {
  const from = Math.max(run.from, run.first, start);
  const to = Math.min(run.to, run.first + samples.length, start + piece.length);
  if (from < to) piece.set(samples.subarray(from - run.first, to - run.first), from - start);
}
