/** Sound of the conformance vectors, and what is heard of packets: runs, gaps, seams (SPEC section 6, "Sound packet"). */
import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { test } from "node:test";
import type { SoundFrame } from "../../src/scene";
import { BLOCK, frameStart, readSoundPacket } from "../../src/container/sound";
import { put, runsOf } from "../../src/sound/runs";
import { createStream } from "../../src/stream/index";
import { EXPECTED, GOOD, vector } from "../decoder/vectors";

interface Sound {
  readonly tracks: readonly { readonly channels: number; readonly position?: readonly number[] }[];
  readonly packets: readonly (readonly [track: number, first: number, blocks: number, hash: string])[];
}

const heard = (name: string): Sound => (EXPECTED[name] as { sound?: Sound }).sound ?? { tracks: [], packets: [] };

for (const name of GOOD.filter((name) => name.startsWith("good/sound") || name === "good/presentation")) {
  test(name, async () => {
    const stream = await createStream(vector(name));
    const { tracks, packets } = heard(name);
    assert.deepEqual(
      stream.header.sound,
      tracks.map(({ channels, position }) => ({ channels, position: position ?? null })),
    );
    await stream.frame(0);
    const found = (await stream.sound(0, EXPECTED[name].frames.length)).flatMap(({ frame, packets }) =>
      packets.map(({ track, offset, blocks }) => {
        const hash = createHash("sha256").update(Buffer.concat(blocks)).digest("hex");
        return [track, frameStart(frame, stream.header.fps!) + offset, blocks.length, hash];
      }),
    );
    assert.deepEqual(found, packets);
    stream.close();
  });
}

const block = new Uint8Array(1);
const blocks = (count: number): Uint8Array<ArrayBuffer>[] => Array.from({ length: count }, () => block);
const frame = (index: number, offset: number, count: number, track = 0): SoundFrame => ({
  frame: index,
  packets: [{ track, offset, blocks: blocks(count) }],
});

test("packets that meet are one run, whatever rounding does to their places", () => {
  // 25 frames a second: 1920 samples, two blocks each.
  const [run, ...more] = runsOf([frame(0, -312, 3), frame(1, 648, 2), frame(2, 600, 2), frame(3, 690, 2)], 0, 25);
  assert.equal(more.length, 0);
  assert.deepEqual([run.first, run.from, run.to, run.blocks.length], [-312, 0, -312 + 9 * BLOCK, 9]);
});

test("a run is heard from its frame on, the one before it up to there, and other tracks are not", () => {
  const [one, two, ...more] = runsOf([frame(0, -312, 3), frame(0, 0, 2, 1), frame(1, -4000, 6), frame(2, 0, 1, 1)], 0, 25);
  assert.equal(more.length, 0);
  assert.deepEqual([one.from, one.to], [0, 1920]);
  assert.deepEqual([two.first, two.from, two.to], [1920 - 4000, 1920, 1920 - 4000 + 6 * BLOCK]);
  const piece = new Float32Array(1920);
  put(piece, 1920, one, new Float32Array(3 * BLOCK).fill(1));
  assert.ok(piece.every((value) => value === 0));
  put(piece, 1920, two, Float32Array.from({ length: 6 * BLOCK }, (_, index) => index));
  assert.equal(piece[0], 4000);
  assert.equal(piece[1759], 5759);
  assert.equal(piece[1760], 0);
});

test("a flood of blocks that nobody hears is not decoded: long before, long after, in many packets of one frame", () => {
  // 25 frames a second: the frame's 1920 samples, and 200 ms before it.
  const [run, ...none] = runsOf([frame(0, -2_000_000_000, 1000), frame(1, -1000 * BLOCK, 1000)], 0, 25);
  assert.equal(none.length, 0);
  assert.deepEqual([run.first, run.to, run.blocks.length], [1920 - 10 * BLOCK, 1920, 10]);
  const packets = Array.from({ length: 64 }, (_, index) => frame(0, -index * 100, 60).packets[0]);
  const runs = runsOf([{ frame: 0, packets }, frame(1, 2_000_000_000, 1000)], 0, 25);
  assert.deepEqual(runs.map(({ blocks }) => blocks.length), [9]);
});

test("a packet of more than 1024 blocks is damaged", () => {
  const payload = (count: number): Uint8Array => Uint8Array.from([0, 0, 0, 0, 0, ...Array.from({ length: count }, () => [1, 0, 252]).flat()]);
  assert.equal(readSoundPacket(payload(1024), 1)?.blocks.length, 1024);
  assert.equal(readSoundPacket(payload(1025), 1), null);
});

test("blocks that begin with the next frame or later are left out", () => {
  const [run] = runsOf([frame(0, 0, 1000)], 0, 25);
  assert.equal(run.blocks.length, 2);
});
