/** Positions from differences of Morton codes: prediction mode 3 (SPEC sections 5 and 6). */

import { refuse } from "../container/errors";

const TWO_TO_31 = 2 ** 31;
const TWO_TO_32 = 2 ** 32;

/** Columns x, y, z of positions; the block has so many planes of the codes' differences. */
export function mortonPositions(block: Uint8Array, planes: number, rows: number, constants: Int32Array): Int32Array {
  const columns = new Int32Array(3 * rows);
  let low = 0;
  let high = 0;
  for (let i = 0; i < rows; i++) {
    low += readUnsigned(block, i, rows, 0, Math.min(planes, 4));
    high += readUnsigned(block, i, rows, 4, planes);
    if (low >= TWO_TO_32) {
      low -= TWO_TO_32;
      high += 1;
    }
    // Differences are unsigned, so a code that would decrease passes 2^63 too.
    if (high >= TWO_TO_31) refuse("bad-payload", "a Morton code is 2^63 or above");
    // Three parts of 21 bits: each has seven of every axis.
    const first = low & 0x1fffff;
    const second = ((low >>> 21) | (high << 11)) & 0x1fffff;
    const third = high >>> 10;
    for (let axis = 0; axis < 3; axis++) {
      const position = everyThird(first >> axis) | (everyThird(second >> axis) << 7) | (everyThird(third >> axis) << 14);
      columns[axis * rows + i] = (position + constants[axis]) | 0;
    }
  }
  return columns;
}

/** The number in planes `from` to `to` of one row, `from` its lowest byte. */
function readUnsigned(block: Uint8Array, row: number, rows: number, from: number, to: number): number {
  let number = 0;
  for (let plane = to - 1; plane >= from; plane--) number = number * 256 + block[plane * rows + row];
  return number;
}

/** Bits 0, 3, ..., 18 side by side. */
function everyThird(bits: number): number {
  let rest = bits & 0x49249;
  rest = (rest | (rest >> 2)) & 0xc30c3;
  rest = (rest | (rest >> 4)) & 0xf00f;
  return (rest | (rest >> 8)) & 0x7f;
}
