/** Which frames are there, of a source that has some of its bytes; and pauses of work that takes long. */
import assert from "node:assert/strict";
import { mock, test } from "node:test";
import { StreamError } from "../../src/container/errors";
import { FrameTable } from "../../src/stream/frameTable";
import { heldFrames, heldShare } from "../../src/stream/heldFrames";
import { Pauses } from "../../src/stream/pauses";

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
