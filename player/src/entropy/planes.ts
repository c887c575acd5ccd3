/** Attribute groups: byte planes, zigzag and prediction (SPEC section 6). */

import { refuse } from "../container/errors";
import type { Fields } from "../container/fields";
import { readBlock } from "./blocks";
import { mortonPositions } from "./morton";

export type Role = "residuals" | "values";

/** Integers of a group, channel after channel: that of row i and channel c is at c * rows + i. */
export type Columns = Int32Array;

/** Columns of up to so many integers in all are written where those of the packet before were. */
const KEPT = 1 << 22;
let scratch = new Int32Array(0);
let scratchUsed = 0;

/**
 * Columns that were read before are no longer needed: their memory is used again.
 *
 * A frame's columns are megabytes that live for milliseconds; setting them aside anew for each packet took as long as
 * filling them.
 */
export function forgetColumns(): void {
  scratchUsed = 0;
}

/** Room for so many integers, which hold anything. */
function newColumns(length: number): Columns {
  const end = scratchUsed + length;
  if (end > KEPT) return new Int32Array(length);
  // Columns that are still in use keep the memory that they have.
  if (end > scratch.length) scratch = new Int32Array(Math.min(KEPT, 2 * end));
  const columns = scratch.subarray(scratchUsed, end);
  scratchUsed = end;
  return columns;
}

const MODE = { PLAIN: 0, SUMS: 1, CONSTANTS: 2, MORTON: 3, CHANNEL_BEFORE: 4 } as const;

/** One group of so many channels and rows; `isMeans`: the one that prediction mode 3 is for. */
export function readGroup(fields: Fields, isMeans: boolean, channels: number, rows: number, role: Role): Columns {
  const mode = fields.u8();
  if (mode > 4 || (mode > 0 && role === "residuals") || (mode === MODE.MORTON && !isMeans)) {
    refuse("unsupported-mode", `prediction mode ${mode} is unknown for ${role}`);
  }
  const constants = new Int32Array(channels);
  if (mode >= MODE.CONSTANTS) for (let c = 0; c < channels; c++) constants[c] = fields.i32();
  if (mode === MODE.MORTON) return readMortonGroup(fields, rows, constants);
  const columns = readColumns(fields, channels, rows);
  if (mode === MODE.SUMS) sumUp(columns, channels, rows);
  else if (mode !== MODE.PLAIN) addConstants(columns, constants, rows, mode === MODE.CHANNEL_BEFORE);
  return columns;
}

function readColumns(fields: Fields, channels: number, rows: number): Columns {
  const counts = fields.take(channels);
  const block = readPlanes(fields, counts, 4, rows);
  const columns = newColumns(channels * rows);
  const positions = planePositions(counts, rows);
  for (let c = 0; c < channels; c++) {
    unzigzag(block, positions[c], columns.subarray(c * rows, (c + 1) * rows));
  }
  return columns;
}

function readPlanes(fields: Fields, counts: Uint8Array, most: number, rows: number): Uint8Array {
  let planes = 0;
  for (const count of counts) {
    if (count > most) refuse("bad-payload", `a channel has ${count} planes`);
    planes += count;
  }
  return readBlock(fields, planes * rows);
}

/** Where the planes of each channel start: plane 0 of all channels that have one, then plane 1, and so on. */
function planePositions(counts: Uint8Array, rows: number): number[][] {
  const positions = Array.from(counts, (): number[] => []);
  let position = 0;
  for (let plane = 0; plane < 4; plane++) {
    for (let c = 0; c < counts.length; c++) {
      if (counts[c] <= plane) continue;
      positions[c].push(position);
      position += rows;
    }
  }
  return positions;
}

/** Integers from the planes of one channel. A loop for each number of planes, since this is where decoding is long. */
function unzigzag(block: Uint8Array, planes: readonly number[], column: Int32Array): void {
  const [p0, p1, p2, p3] = planes;
  const rows = column.length;
  if (planes.length === 0) {
    column.fill(0);
  } else if (planes.length === 1) {
    for (let i = 0; i < rows; i++) {
      const code = block[p0 + i];
      column[i] = (code >> 1) ^ -(code & 1);
    }
  } else if (planes.length === 2) {
    for (let i = 0; i < rows; i++) {
      const code = block[p0 + i] | (block[p1 + i] << 8);
      column[i] = (code >> 1) ^ -(code & 1);
    }
  } else if (planes.length === 3) {
    for (let i = 0; i < rows; i++) {
      const code = block[p0 + i] | (block[p1 + i] << 8) | (block[p2 + i] << 16);
      column[i] = (code >> 1) ^ -(code & 1);
    }
  } else {
    for (let i = 0; i < rows; i++) {
      const code = block[p0 + i] | (block[p1 + i] << 8) | (block[p2 + i] << 16) | (block[p3 + i] << 24);
      column[i] = (code >>> 1) ^ -(code & 1);
    }
  }
}

function sumUp(columns: Columns, channels: number, rows: number): void {
  for (let c = 0; c < channels; c++) {
    let sum = 0;
    for (let i = c * rows; i < (c + 1) * rows; i++) {
      sum = (sum + columns[i]) | 0;
      columns[i] = sum;
    }
  }
}

function addConstants(columns: Columns, constants: Int32Array, rows: number, channelBefore: boolean): void {
  for (let c = 0; c < constants.length; c++) {
    const constant = constants[c];
    const before = channelBefore && c > 0;
    for (let i = c * rows; i < (c + 1) * rows; i++) {
      columns[i] = (columns[i] + constant + (before ? columns[i - rows] : 0)) | 0;
    }
  }
}

function readMortonGroup(fields: Fields, rows: number, constants: Int32Array): Columns {
  const counts = fields.take(1);
  const block = readPlanes(fields, counts, 8, rows);
  return mortonPositions(block, counts[0], rows, constants);
}
