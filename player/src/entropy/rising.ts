/** Rows one after the other, as everything that is new or whole has them. */

import { countUp } from "../kernel/blocks";

let rising = new Uint32Array(0);

/** 0, 1, 2, ...; to be read only, since whoever asks next gets the same numbers. */
export function allRows(count: number): Uint32Array {
  if (count > rising.length) {
    rising = new Uint32Array(Math.ceil(count * 1.25));
    countUp(rising);
  }
  return rising.subarray(0, count);
}

/** From `start` to before `end`; to be read only. */
export function rowsBetween(start: number, end: number): Uint32Array {
  return allRows(end).subarray(start);
}
