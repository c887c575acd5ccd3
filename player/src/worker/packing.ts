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
const rotation = new Float64Array(4);

/** Writes the eight words of row `row` at `at`. */
export function packBase(gaussians: Gaussians, coefficients: number, row: number, words: Uint32Array, at: number): void {
  const { means, logScales, opacityLogits, sh } = gaussians;
  for (let axis = 0; axis < 3; axis++) {
    word[0] = means[3 * row + axis]!;
    words[at + axis] = wordBits[0]!;
  }
  const colour = 3 * coefficients * row;
  const opacity = 1 / (1 + Math.exp(-opacityLogits[row]));
  words[at + 3] = halfBits(sh[colour]) | (halfBits(sh[colour + 1]) << 16);
  words[at + 4] = halfBits(sh[colour + 2]) | (Math.round(opacity * 65535) << 16);
  words[at + 5] = logScaleBits(logScales[3 * row]) | (logScaleBits(logScales[3 * row + 1]) << 16);
  const [first, others] = rotationBits(gaussians.quaternions, 4 * row);
  words[at + 6] = logScaleBits(logScales[3 * row + 2]) | (first << 16);
  words[at + 7] = others;
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

function logScaleBits(value: number): number {
  const steps = Math.round((value + LOG_SCALE_LIMIT) * LOG_SCALE_STEPS);
  return steps < 0 ? 0 : steps > 65535 ? 65535 : steps;
}

const packed: [number, number] = [0, 0];

/** The first of the smaller three components, and the word of the other two. A zero quaternion is no rotation. */
function rotationBits(quaternions: Float32Array, at: number): readonly [number, number] {
  let largest = 0;
  let square = 0;
  for (let i = 0; i < 4; i++) {
    const part = (rotation[i] = quaternions[at + i]!);
    square += part * part;
    if (Math.abs(part) > Math.abs(rotation[largest])) largest = i;
  }
  if (square === 0) rotation[0] = square = 1;
  const scale = (Math.SQRT2 * ROTATION_STEPS * (rotation[largest] < 0 ? -1 : 1)) / Math.sqrt(square);
  let others = 0;
  let place = 0;
  for (let i = 0; i < 4; i++) {
    if (i === largest) continue;
    const steps = Math.round(rotation[i] * scale) + ROTATION_STEPS;
    if (place === 0) packed[0] = steps;
    else if (place === 1) others = steps | ((largest & 1) << 15);
    else others |= (steps << 16) | ((largest >> 1) << 31);
    place++;
  }
  packed[1] = others >>> 0;
  return packed;
}
