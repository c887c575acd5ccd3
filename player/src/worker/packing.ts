/**
 * Gaussians as words of the data textures: 32 bytes each, and 16 a texel for the harmonics above degree 0.
 *
 * | word | low half | high half |
 * |---|---|---|
 * | 0 to 2 | mean x, y, z, float32 | |
 * | 3 | red of degree 0, half | green |
 * | 4 | blue | opacity, 16 bits of 0..1 |
 * | 5 | log-scale 0, 16 bits of -40..40 | log-scale 1 |
 * | 6 | log-scale 2 | rotation, first of the smaller three |
 * | 7 | second | third |
 *
 * A rotation's largest component is made positive and left out; each of the others has 15 bits of -1/sqrt(2)..1/sqrt(2),
 * and the top bits of the second and third say which one is left out. Against float32 textures the pictures differ by
 * less than their last bit (tests/browser), for half the bytes to send.
 */
import type { Gaussians } from "../scene";
import type { TextureLayout } from "../messages";
import { halfBits } from "./half_floats";

export const BASE_WORDS = 8;
const LOG_SCALE_LIMIT = 40;
const LOG_SCALE_STEPS = 65535 / (2 * LOG_SCALE_LIMIT);
const ROTATION_STEPS = 16383;

export function textureLayout(shDegree: number): TextureLayout {
  const halves = 3 * ((shDegree + 1) ** 2 - 1);
  return { shDegree, restTexels: Math.ceil(halves / 8) };
}

const word = new Float32Array(1);
const wordBits = new Uint32Array(word.buffer);

/** Writes the eight words of row `row` at `at`. */
export function packBase(gaussians: Gaussians, coefficients: number, row: number, words: Uint32Array, at: number): void {
  const { means, logScales, opacityLogits, sh } = gaussians;
  for (let axis = 0; axis < 3; axis++) {
    word[0] = means[3 * row + axis];
    words[at + axis] = wordBits[0];
  }
  const colour = 3 * coefficients * row;
  const opacity = 1 / (1 + Math.exp(-opacityLogits[row]));
  words[at + 3] = halfBits(sh[colour]) | (halfBits(sh[colour + 1]) << 16);
  words[at + 4] = halfBits(sh[colour + 2]) | (rounded(opacity * 65535) << 16);
  words[at + 5] = logScaleBits(logScales[3 * row]) | (logScaleBits(logScales[3 * row + 1]) << 16);
  words[at + 6] = logScaleBits(logScales[3 * row + 2]);
  packRotation(gaussians.quaternions, 4 * row, words, at + 6);
}

/** Writes the higher harmonics of row `row`, coefficient by coefficient, as halves. */
export function packRest(gaussians: Gaussians, coefficients: number, row: number, words: Uint32Array, at: number): void {
  const { sh } = gaussians;
  const from = 3 * coefficients * row + 3;
  const halves = 3 * (coefficients - 1);
  for (let i = 0; i < halves; i += 2) {
    const high = i + 1 < halves ? halfBits(sh[from + i + 1]) << 16 : 0;
    words[at + (i >> 1)] = halfBits(sh[from + i]) | high;
  }
}

/** To the nearest integer, of numbers from 0 to 2^31: a third of the time of Math.round. */
function rounded(value: number): number {
  return (value + 0.5) | 0;
}

function logScaleBits(value: number): number {
  const steps = rounded((value + LOG_SCALE_LIMIT) * LOG_SCALE_STEPS);
  return steps < 0 ? 0 : steps > 65535 ? 65535 : steps;
}

/** Writes the smaller three components, from the upper half of the word at `at` on. A zero quaternion is no rotation. */
function packRotation(quaternions: Float32Array, from: number, words: Uint32Array, at: number): void {
  let [w, x, y, z] = [quaternions[from], quaternions[from + 1], quaternions[from + 2], quaternions[from + 3]];
  const square = w * w + x * x + y * y + z * z;
  if (square === 0) w = 1;
  const [aw, ax, ay, az] = [Math.abs(w), Math.abs(x), Math.abs(y), Math.abs(z)];
  let largest = 0;
  let left = w;
  // What is left out gives its place to the ones before it.
  if (ax > aw && ax >= ay && ax >= az) [largest, left, x] = [1, x, w];
  else if (ay > aw && ay >= az) [largest, left, y, x] = [2, y, x, w];
  else if (az > aw) [largest, left, z, y, x] = [3, z, y, x, w];
  const scale = ((left < 0 ? -Math.SQRT2 : Math.SQRT2) * ROTATION_STEPS) / (square === 0 ? 1 : Math.sqrt(square));
  const steps = (part: number): number => rounded(part * scale + ROTATION_STEPS);
  words[at] |= steps(x) << 16;
  words[at + 1] = steps(y) | ((largest & 1) << 15) | (steps(z) << 16) | ((largest >> 1) << 31);
}
