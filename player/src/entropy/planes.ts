/** Attribute groups: byte planes, zigzag and prediction (SPEC section 6). */

import { refuse } from "../container/errors";
import type { Fields } from "../container/fields";
import { readBlock } from "./blocks";
import { mortonColumns, sumColumn } from "../kernel/blocks";

export type Role = "residuals" | "values";

/** Integers of a group, channel after channel: that of row i and channel c is at c * rows + i. */
export type Columns = Int32Array;

/** A group as its bytes, which the kernel turns into integers batch by batch: most of a frame's bytes never become columns. */
export interface Planes {
  readonly block: Uint8Array;
  /** By channel, where each of its planes starts, lowest bytes first. */
  readonly starts: readonly (readonly number[])[];
  /** By channel, what is to be added to its integers. */
  readonly constants: Int32Array;
  /** Whether the integer of the channel before is to be added, too. */
  readonly channelBefore: boolean;
}

const MODE = { PLAIN: 0, SUMS: 1, CONSTANTS: 2, MORTON: 3, CHANNEL_BEFORE: 4 } as const;

/** One group of so many channels and rows; `isMeans`: the one that prediction mode 3 is for. */
export function readGroup(fields: Fields, isMeans: boolean, channels: number, rows: number, role: Role): Columns | Planes {
  const mode = fields.u8();
  if (mode > 4 || (mode > 0 && role === "residuals") || (mode === MODE.MORTON && !isMeans)) {
    refuse("unsupported-mode", `prediction mode ${mode} is unknown for ${role}`);
  }
  const constants = new Int32Array(channels);
  if (mode >= MODE.CONSTANTS) for (let c = 0; c < channels; c++) constants[c] = fields.i32();
  if (mode === MODE.MORTON) return readMortonGroup(fields, rows, constants);
  const counts = fields.take(channels);
  const block = readPlanes(fields, counts, 4, rows);
  const starts = planePositions(counts, rows);
  if (mode === MODE.SUMS) return sums(block, starts, rows);
  return { block, starts, constants, channelBefore: mode === MODE.CHANNEL_BEFORE };
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

/** Every integer is the sum of all up to it. */
function sums(block: Uint8Array, starts: readonly (readonly number[])[], rows: number): Columns {
  const columns = new Int32Array(starts.length * rows);
  starts.forEach((planes, channel) => {
    sumColumn(block, planes, rows, columns.subarray(channel * rows, (channel + 1) * rows));
  });
  return columns;
}

function readMortonGroup(fields: Fields, rows: number, constants: Int32Array): Columns {
  const counts = fields.take(1);
  const block = readPlanes(fields, counts, 8, rows);
  const starts = Array.from({ length: counts[0] }, (_, plane) => plane * rows);
  return mortonColumns(block, starts, rows, constants) ?? refuse("bad-payload", "a Morton code is 2^63 or above");
}
