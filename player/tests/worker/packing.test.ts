/** What is packed for the textures, read back as the shader does; and the order by depth against a plain sort. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { DepthSorter } from "../../src/worker/depth_order";
import { halfBits } from "../../src/worker/half_floats";
import { packBase } from "../../src/worker/packing";

function half(bits: number): number {
  const [sign, exponent, mantissa] = [bits >> 15 ? -1 : 1, (bits >> 10) & 31, bits & 1023];
  return exponent === 0 ? sign * mantissa * 2 ** -24 : sign * (1 + mantissa / 1024) * 2 ** (exponent - 15);
}

test("halves are the nearest ones, and the largest beyond", () => {
  for (let bits = 0; bits < 0x7c00; bits += 7) {
    assert.equal(halfBits(half(bits)), bits);
    assert.equal(halfBits(-half(bits)), bits | 0x8000);
  }
  for (let i = 0; i < 5000; i++) {
    const value = (Math.random() - 0.5) * 2 ** (Math.random() * 30 - 18);
    const error = Math.abs(half(halfBits(value)) - value);
    assert.ok(error <= Math.max(2 ** -24, Math.abs(value) * 2 ** -11) * 1.000001, `${value}`);
  }
  assert.equal(half(halfBits(1e9)), 65504);
  assert.equal(half(halfBits(65519)), 65504);
});

test("a Gaussian's rotation, scale, opacity and place survive packing", () => {
  for (let trial = 0; trial < 300; trial++) {
    const random = (): number => Math.random() * 2 - 1;
    const quaternion = trial === 0 ? [0, 0, 0, 0] : trial < 5 ? [0, 1, 2, 3].map((i) => (i === trial - 1 ? -2 : 0)) : [0, 0, 0, 0].map(random);
    const gaussians = {
      count: 1,
      means: Float32Array.from([random(), 100 * random(), -0.25]),
      logScales: Float32Array.from([-40, random() * 8, 40]),
      quaternions: Float32Array.from(quaternion),
      opacityLogits: Float32Array.from([6 * random()]),
      sh: Float32Array.from([random(), random(), random()]),
      order: null,
    };
    const words = new Uint32Array(8);
    packBase(gaussians, 1, 0, words, 0);
    assert.deepEqual(new Float32Array(words.buffer, 0, 3), gaussians.means);
    const opacity = 1 / (1 + Math.exp(-gaussians.opacityLogits[0]));
    assert.ok(Math.abs((words[4] >>> 16) / 65535 - opacity) < 1e-5);
    const scales = [words[5] & 0xffff, words[5] >>> 16, words[6] & 0xffff].map((bits) => (bits * 80) / 65535 - 40);
    scales.forEach((scale, i) => {
      assert.ok(Math.abs(scale - gaussians.logScales[i]) < 7e-4);
    });
    const found = rotation(words);
    const norm = Math.hypot(...quaternion) || 1;
    const expected = Math.hypot(...quaternion) === 0 ? [1, 0, 0, 0] : quaternion.map((part) => part / norm);
    const same = Math.abs(found.reduce((sum, part, i) => sum + part * expected[i], 0));
    assert.ok(same > 1 - 1e-8, `${found.join()} is not ${expected.join()}`);
  }
});

/** As the vertex shader reads it. */
function rotation(words: Uint32Array): number[] {
  const fields = [words[6] >>> 16, words[7] & 0xffff, words[7] >>> 16];
  const small = fields.map((field) => ((field & 0x7fff) - 16383) / (16383 * Math.SQRT2));
  const largest = (fields[1] >> 15) | ((fields[2] >> 15) << 1);
  const rest = Math.sqrt(Math.max(0, 1 - small.reduce((sum, part) => sum + part * part, 0)));
  return [...small.slice(0, largest), rest, ...small.slice(largest)];
}

test("the order is by depth, nearest first, without what lies behind", () => {
  const count = 5000;
  const means = Float32Array.from({ length: 3 * count }, () => Math.random() * 20 - 10);
  means.set([0, 0, 1e6], 300); // one at the horizon
  const order = new Uint32Array(count);
  const drawn = new DepthSorter().sort(means, count, [0, 0, 1, 0.5], order);
  const depth = (row: number): number => means[3 * row + 2] + 0.5;
  const expected = Array.from({ length: count }, (_, row) => row).filter((row) => depth(row) > 0);
  assert.deepEqual([...order.subarray(0, drawn)].sort((a, b) => a - b), expected);
  for (let at = 1; at < drawn; at++) assert.ok(depth(order[at]) > depth(order[at - 1]) * (1 - 1e-3));
});

test("no Gaussians, and none before the camera, are no order", () => {
  const sorter = new DepthSorter();
  assert.equal(sorter.sort(new Float32Array(0), 0, [0, 0, 1, 0], new Uint32Array(0)), 0);
  assert.equal(sorter.sort(Float32Array.from([0, 0, -1, 0, 0, NaN]), 2, [0, 0, 1, 0], new Uint32Array(2)), 0);
});
