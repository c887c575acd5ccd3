/** Streams opened as the worker opens them: every frame of the conformance streams, in order and by seeking. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { StreamError, createStream } from "../../src/stream/index";
import { hashOf } from "./inOrder";
import { EXPECTED, GOOD, shownFrames, vector } from "./vectors";

const WITHIN_LIMITS = GOOD.filter((name) => EXPECTED[name].limits === undefined);

for (const name of WITHIN_LIMITS) {
  test(`${name}, in order and backwards`, async () => {
    const frames = shownFrames(EXPECTED[name]);
    const stream = await createStream(vector(name));
    await stream.prefetch(0);
    assert.equal(stream.frames.length, frames.length);
    const order = [...frames.keys(), ...[...frames.keys()].reverse()];
    for (const index of order) {
      const frame = await stream.frame(index);
      assert.equal(frame.damage, null);
      assert.equal(frame.gaussians.count, frames[index].gaussians);
      assert.equal(hashOf(frame), frames[index].floats, `frame ${index}`);
    }
    // What is not there might still have come: then nothing is said.
    if (EXPECTED[name].layers?.failure == null) assert.deepEqual(stream.notices, []);
  });
}

for (const [name, { frames, failure }] of Object.entries(EXPECTED)) {
  if (failure === null || EXPECTED[name].limits !== undefined) continue;
  test(`${name}, damaged: good frames are shown, or it says why not`, async () => {
    try {
      const stream = await createStream(vector(name));
      for (let index = 0; index < frames.length; index++) {
        assert.equal(hashOf(await stream.frame(index)), frames[index].floats, `frame ${index}`);
      }
      await stream.frame(frames.length);
    } catch (error) {
      assert.ok(error instanceof StreamError, String(error));
    }
  });
}

test("a subject's header says so", async () => {
  const said = async (name: string): Promise<boolean> => (await createStream(vector(name))).header.subject;
  assert.equal(await said("good/subject"), true);
  assert.equal(await said("good/worked-example"), false);
});

test("a frame that is no whole number is not in the stream", async () => {
  const stream = await createStream(vector(WITHIN_LIMITS[0]));
  for (const index of [0.5, -1, NaN, Infinity, -0.5]) {
    await assert.rejects(
      stream.frame(index),
      (error) => error instanceof StreamError && error.message.startsWith(`frame ${index} is not in this stream`),
    );
  }
  assert.equal((await stream.frame(0)).damage, null);
});
