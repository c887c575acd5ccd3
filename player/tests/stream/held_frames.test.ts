/** Which frames are there, of a source that has some of its bytes; what stands behind them; and pauses of work that takes long. */
import assert from "node:assert/strict";
import { mock, test } from "node:test";
import { StreamError } from "../../src/container/errors";
import { DEFAULT_LIMITS } from "../../src/container/limits";
import { KIND } from "../../src/container/packets";
import { joined } from "../../src/stream/bytes";
import { FrameTable } from "../../src/stream/frameTable";
import { heldFrames, heldShare, refinedFrames } from "../../src/stream/heldFrames";
import { Metrics } from "../../src/stream/metrics";
import { Pauses } from "../../src/stream/pauses";
import { readSound } from "../../src/stream/sound";
import { MemorySource } from "../../src/stream/sources";
import { packet } from "./packets";

/** Frames of 10 bytes from byte 100 on, a keyframe first; frame 2 is lost. */
function table(): FrameTable {
  const frames = new FrameTable();
  frames.add("key", 100, 10);
  frames.add("delta", 110, 10);
  frames.addLost(3, new StreamError("frame-order", "it is missing"));
  frames.add("delta", 120, 10);
  frames.add("delta", 130, 10);
  return frames;
}

test("a frame is there when its last byte is; a lost one need not be waited for", () => {
  assert.deepEqual(heldFrames(table(), [[100, 119]]), [[0, 1], [2, 3]]);
  assert.deepEqual(heldFrames(table(), [[100, 120]]), [[0, 3]]);
  assert.deepEqual(heldFrames(table(), [[0, 110], [115, 140]]), [[0, 1], [2, 5]]);
  assert.deepEqual(heldFrames(table(), [[101, 140]]), [[1, 5]]);
  assert.deepEqual(heldFrames(table(), undefined), [[0, 5]]);
  assert.deepEqual(heldFrames(new FrameTable(), undefined), []);
});

test("a frame is refined when what refines it is there, or nothing does", () => {
  const frames = table();
  frames.add("skip", 140, 10);
  assert.deepEqual(refinedFrames(frames, [[0, 500]]), []);
  frames.refinements = new Map([0, 1, 3].map((frame, place) => [frame, { offset: 200 + 10 * place, bytes: 10 }]));
  assert.deepEqual(refinedFrames(frames, [[100, 209], [210, 500]]), [[1, 2], [3, 4], [5, 6]]);
  assert.deepEqual(refinedFrames(frames, undefined), [[0, 2], [3, 4], [5, 6]]);
});

test("the share of what leads to a frame is that of the bytes from its keyframe on", () => {
  assert.equal(heldShare(table(), [[0, 110], [125, 500]], 3), 0.5);
  assert.equal(heldShare(table(), [[0, 110], [125, 500]], 99), 0.625);
  assert.equal(heldShare(table(), [], 0), 0);
  assert.equal(heldShare(table(), undefined, 3), 1);
  assert.equal(heldShare(table(), [], 2), 1, "a lost one");
  assert.equal(heldShare(new FrameTable(), [], 0), 1);
});

test("work that takes long pauses every 20 ms, and lets in what waits", async () => {
  let now = 0;
  mock.method(performance, "now", () => now);
  const pauses = new Pauses();
  let others = 0;
  setTimeout(() => others++);
  now = 19;
  await pauses.take();
  assert.equal(others, 0);
  now = 20;
  await pauses.take();
  assert.equal(others, 1);
  setTimeout(() => others++);
  now = 39;
  await pauses.take();
  assert.equal(others, 1);
  now = 45;
  pauses.begin();
  await pauses.take();
  assert.equal(others, 1);
  mock.restoreAll();
});

/** Frames, each with these packets behind its own, and the table that says where they lie. */
function framesWith(...behind: Uint8Array[][]): { readonly source: MemorySource; readonly frames: FrameTable } {
  const frames = new FrameTable();
  const parts: Uint8Array[] = [];
  behind.forEach((packets, frame) => {
    const own = packet(KIND.DELTA, frame, new Uint8Array(3));
    const all = joined([own, ...packets]);
    frames.add("delta", parts.reduce((sum, { length }) => sum + length, 0), all.length);
    parts.push(all);
  });
  return { source: new MemorySource(joined(parts)), frames };
}

/** A block of one byte on a track of sound. */
const sound = (frame: number, byte: number, track = 0): Uint8Array => packet(KIND.SOUND, frame, new Uint8Array([track, 0, 0, 0, 0, 1, 0, byte]));

test("a frame's sound is that of its own packets, 64 of them at most, damaged ones among these", async () => {
  const many = Array.from({ length: 70 }, (_, byte) => sound(1, byte, byte === 5 ? 1 : 0));
  const { source, frames } = framesWith([sound(0, 9)], [sound(0, 8), packet(KIND.METRICS, 1, new Uint8Array(1)), ...many]);
  const read = async (frame: number): Promise<number[]> => {
    const { frame: of, packets } = await readSound(source, frames, frame, 1, DEFAULT_LIMITS);
    assert.equal(of, frame);
    return packets.map(({ blocks }) => blocks[0][0]);
  };
  assert.deepEqual(await read(0), [9]);
  assert.deepEqual(await read(1), Array.from({ length: 64 }, (_, byte) => byte).filter((byte) => byte !== 5));
});

test("figures are looked for once behind each frame, up to an offset, while that goes on", async () => {
  const figures = (frame: number): Uint8Array => packet(KIND.METRICS, frame, new TextEncoder().encode(`{"psnr": ${30 + frame}}`));
  const { source, frames } = framesWith([figures(0)], [figures(1)], [figures(2)], [figures(3)]);
  const metrics = new Metrics();
  const reads = mock.method(source, "read");
  await metrics.find(source, frames, 0, frames.offset(3), DEFAULT_LIMITS, () => metrics.byFrame.size < 2);
  assert.deepEqual([...metrics.byFrame.keys()], [0, 1]);
  await metrics.find(source, frames, 1, frames.offset(3), DEFAULT_LIMITS, () => true);
  assert.deepEqual([...metrics.byFrame], [[0, { psnr: 30 }], [1, { psnr: 31 }], [2, { psnr: 32 }]]);
  const count = reads.mock.callCount();
  await metrics.find(source, frames, 0, frames.offset(3), DEFAULT_LIMITS, () => true);
  assert.equal(reads.mock.callCount(), count);
});
