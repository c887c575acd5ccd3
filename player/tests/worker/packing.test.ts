/** What is packed for the textures, read back as the shader does; and the order by depth against a plain sort. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { DepthSorter } from "../../src/worker/depth_order";
import { Packer, textureLayout } from "../../src/worker/packing";

function half(bits: number): number {
  const [sign, exponent, mantissa] = [bits >> 15 ? -1 : 1, (bits >> 10) & 31, bits & 1023];
  return exponent === 0 ? sign * mantissa * 2 ** -24 : sign * (1 + mantissa / 1024) * 2 ** (exponent - 15);
}

/** Halves of so many numbers, as harmonics of degree 1: nine of a Gaussian, in the words of two texels. */
function halves(values: number[]): number[] {
  const count = Math.ceil(values.length / 9);
  const sh = new Float32Array(12 * count);
  values.forEach((value, i) => (sh[12 * Math.floor(i / 9) + 3 + (i % 9)] = value));
  const zeros = (each: number): Float32Array => new Float32Array(each * count);
  const gaussians = { count, means: zeros(3), logScales: zeros(3), quaternions: zeros(4), opacityLogits: zeros(1), sh, order: null };
  const rest = new Uint32Array(8 * count);
  new Packer(textureLayout(1)).pack(gaussians, null, new Uint32Array(8 * count), rest);
  return values.map((_, i) => (rest[8 * Math.floor(i / 9) + ((i % 9) >> 1)] >>> (16 * ((i % 9) % 2))) & 0xffff);
}

test("halves are the nearest ones, and the largest beyond", () => {
  const all = Array.from({ length: 0x7c00 }, (_, bits) => bits);
  assert.deepEqual(halves(all.map(half)), all);
  assert.deepEqual(halves(all.map((bits) => -half(bits))).slice(1), all.slice(1).map((bits) => bits | 0x8000));
  // Packed from float32: a number between two halves would otherwise be rounded twice.
  const values = Array.from({ length: 5000 }, () => Math.fround((Math.random() - 0.5) * 2 ** (Math.random() * 30 - 18)));
  halves(values).forEach((bits, i) => {
    const error = Math.abs(half(bits) - values[i]);
    assert.ok(error <= Math.max(2 ** -25, Math.abs(values[i]) * 2 ** -11) * 1.000001, `${values[i]}`);
  });
  assert.deepEqual(halves([1e9, 65519, -1e9]).map(half), [65504, 65504, -65504]);
});

test("some places are packed as all are, in their order", () => {
  for (const degree of [0, 3]) {
    const layout = textureLayout(degree);
    const random = (each: number): Float32Array => Float32Array.from({ length: 3000 * each }, () => Math.random() - 0.5);
    const sh = random(3 * (degree + 1) ** 2);
    const gaussians = { count: 3000, means: random(3), logScales: random(3), quaternions: random(4), opacityLogits: random(1), sh, order: null };
    const packer = new Packer(layout);
    const words = 4 * layout.restTexels;
    const [base, rest] = [new Uint32Array(8 * 3000), new Uint32Array(words * 3000)];
    packer.pack(gaussians, null, base, rest);
    const places = Uint32Array.from({ length: 1500 }, (_, i) => (7 * i) % 3000);
    const [someBase, someRest] = [new Uint32Array(8 * 1500), new Uint32Array(words * 1500)];
    packer.pack(gaussians, places, someBase, someRest);
    places.forEach((place, i) => {
      assert.deepEqual(someBase.subarray(8 * i, 8 * i + 8), base.subarray(8 * place, 8 * place + 8));
      assert.deepEqual(someRest.subarray(words * i, words * (i + 1)), rest.subarray(words * place, words * (place + 1)));
    });
  }
});

test("a Gaussian's rotation, scale, opacity and place survive packing", () => {
  const packer = new Packer(textureLayout(0));
  for (let trial = 0; trial < 300; trial++) {
    const random = (): number => Math.random() * 2 - 1;
    const quaternion = trial === 0 ? [0, 0, 0, 0] : trial < 5 ? [0, 1, 2, 3].map((i) => (i === trial - 1 ? -2 : 0)) : [0, 0, 0, 0].map(random);
    const gaussians = {
      count: 1,
      means: Float32Array.from([random(), 100 * random(), -0.25]),
      logScales: Float32Array.from([-40, random() * 8, 40]),
      quaternions: Float32Array.from(quaternion),
      opacityLogits: Float32Array.from([(trial % 2 ? 80 : 6) * random()]),
      sh: Float32Array.from([random(), random(), random()]),
      order: null,
    };
    const words = new Uint32Array(8);
    packer.pack(gaussians, null, words, null);
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
