/** What SuperSplat is given: the floats of the conformance streams, found by the names that a .ply has. */

import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { test } from "node:test";
import type { SplatElement } from "../../src/export/elements";
import { createFrameSource } from "../../src/export/frame_source";
import { StreamError } from "../../src/stream/index";
import { EXPECTED, GOOD, shownFrames, vector } from "./vectors";

const WITH_INDEX = GOOD.find((name) => EXPECTED[name].indexes?.length === 1 && EXPECTED[name].limits === undefined)!;

// Where a transform brings frames is compared in tests/export.
const STORED = GOOD.filter((name) => EXPECTED[name].limits === undefined && EXPECTED[name].presentation?.transform === undefined);
for (const name of STORED) {
  test(`${name}, all frames asked for at once, the last one first`, async () => {
    const frames = shownFrames(EXPECTED[name]);
    const source = await createFrameSource(vector(name));
    assert.equal(source.frameCount, frames.length);
    const asked = [...frames.keys()].reverse();
    const given = await Promise.all(asked.map((index) => source.getFrame(index)));
    for (const [place, index] of asked.entries()) {
      const [element] = given[place];
      assert.equal(element.count, frames[index].gaussians);
      assert.equal(floatsHash(element), frames[index].floats, `frame ${index}`);
    }
  });
}

test("frames are found without an index, and none beyond them", async () => {
  const whole = vector(WITH_INDEX);
  const source = await createFrameSource(whole.subarray(0, whole.length - 40));
  assert.equal(source.frameCount, EXPECTED[WITH_INDEX].frames.length);
  await assert.rejects(source.getFrame(source.frameCount), StreamError);
  await source.getFrame(0);
  source.destroy();
  await assert.rejects(source.getFrame(0), StreamError);
});

/** As tests/conformance/README.md has it: means, log-scales, quaternions, opacity, SH with the colours of each together. */
function floatsHash({ count, properties }: SplatElement): string {
  const storage = new Map(properties.map((property) => [property.name, property.storage]));
  assert.equal(storage.size, properties.length);
  const rest = [...storage.keys()].filter((name) => name.startsWith("f_rest_")).length / 3;
  const names = "x y z scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 opacity f_dc_0 f_dc_1 f_dc_2".split(" ");
  for (let k = 0; k < rest; k++) for (let colour = 0; colour < 3; colour++) names.push(`f_rest_${rest * colour + k}`);
  assert.equal(names.length, properties.length);
  const columns = names.map((name) => storage.get(name)!);
  const floats = new Float32Array(count * columns.length);
  for (let row = 0, at = 0; row < count; row++) for (const column of columns) floats[at++] = column[row];
  return createHash("sha256").update(floats).digest("hex");
}
