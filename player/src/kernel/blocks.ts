/** What is read of bytes from the first to the last, by one instance of the kernel (blocks.c). */

import { BATCH } from "./batch";
import { kernelInstance } from "./module";

/** Bytes that the kernel takes at once for a checksum. */
const CHUNK = 65_536;

interface Exports {
  readonly memory: WebAssembly.Memory;
  block_bytes_at(): number;
  block_columns_at(): number;
  block_begin(): void;
  crc32(before: number, length: number): number;
  count_up(from: number, rows: number): void;
  sums(planes: number, rows: number): void;
  morton(planes: number, rows: number, x: number, y: number, z: number): number;
}

interface Blocks {
  readonly kernel: Exports;
  readonly bytes: Uint8Array;
  readonly columns: Int32Array;
}

let made: Blocks | null = null;

function blocks(): Blocks {
  if (made === null) {
    const kernel = kernelInstance() as unknown as Exports;
    const { buffer } = kernel.memory;
    const bytes = new Uint8Array(buffer, kernel.block_bytes_at(), CHUNK);
    made = { kernel, bytes, columns: new Int32Array(buffer, kernel.block_columns_at(), 3 * BATCH) };
  }
  return made;
}

/** CRC-32 of ISO 3309 and zlib (SPEC section 3). */
export function crc32(data: Uint8Array): number {
  const { kernel, bytes } = blocks();
  let crc = 0;
  for (let from = 0; from < data.length; from += CHUNK) {
    const chunk = data.subarray(from, from + CHUNK);
    bytes.set(chunk);
    crc = kernel.crc32(crc, chunk.length);
  }
  return crc >>> 0;
}

/** Fills an array with 0, 1, 2, ... */
export function countUp(numbers: Uint32Array): void {
  const { kernel, columns } = blocks();
  for (let from = 0; from < numbers.length; from += BATCH) {
    const count = Math.min(BATCH, numbers.length - from);
    kernel.count_up(from, count);
    numbers.set(columns.subarray(0, count), from);
  }
}

/** A column of integers each of which is the sum of all up to it; `starts`: where its planes start. */
export function sumColumn(block: Uint8Array, starts: readonly number[], rows: number, column: Int32Array): void {
  const { kernel, columns } = blocks();
  kernel.block_begin();
  for (let from = 0; from < rows; from += BATCH) {
    const count = Math.min(BATCH, rows - from);
    takePlanes(block, starts, from, count);
    kernel.sums(starts.length, count);
    column.set(columns.subarray(0, count), from);
  }
}

/** Columns x, y, z of positions from Morton codes, constants added; null where a code is 2^63 or above. */
export function mortonColumns(
  block: Uint8Array,
  starts: readonly number[],
  rows: number,
  [x, y, z]: Int32Array,
): Int32Array | null {
  const { kernel, columns } = blocks();
  const all = new Int32Array(3 * rows);
  kernel.block_begin();
  for (let from = 0; from < rows; from += BATCH) {
    const count = Math.min(BATCH, rows - from);
    takePlanes(block, starts, from, count);
    if (kernel.morton(starts.length, count, x, y, z) === 0) return null;
    for (let axis = 0; axis < 3; axis++) {
      all.set(columns.subarray(axis * BATCH, axis * BATCH + count), axis * rows + from);
    }
  }
  return all;
}

function takePlanes(block: Uint8Array, starts: readonly number[], from: number, rows: number): void {
  const { bytes } = blocks();
  starts.forEach((start, plane) => {
    bytes.set(block.subarray(start + from, start + from + rows), BATCH * plane);
  });
}
