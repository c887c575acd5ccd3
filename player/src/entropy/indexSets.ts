/** Index sets: which rows a packet touches or removes (SPEC section 6). */

import { refuse } from "../container/errors";
import type { Fields } from "../container/fields";
import { readBlock, readVarints } from "./blocks";
import { allRows } from "./rising";

/** Rows out of so many, rising. */
export function readIndexSet(fields: Fields, population: number): Uint32Array {
  const tag = fields.u8();
  if (tag === 0) return new Uint32Array(0);
  if (tag === 1) return allRows(population);
  if (tag === 2) return readBitmap(fields, population);
  if (tag === 3) return readGaps(fields, population);
  refuse("unsupported-mode", `index set tag ${tag} is unknown`);
}

function readBitmap(fields: Fields, population: number): Uint32Array {
  const bits = readBlock(fields, Math.ceil(population / 8));
  if (population % 8 && bits[bits.length - 1] >> (population % 8)) bad("a bitmap has a bit beyond the last row");
  const rows = new Uint32Array(countBits(bits));
  let count = 0;
  for (let i = 0; i < bits.length; i++) {
    for (let byte = bits[i]; byte; byte &= byte - 1) rows[count++] = 8 * i + 31 - Math.clz32(byte & -byte);
  }
  return rows;
}

function countBits(bits: Uint8Array): number {
  let count = 0;
  for (const byte of bits) for (let rest = byte; rest; rest &= rest - 1) count++;
  return count;
}

function readGaps(fields: Fields, population: number): Uint32Array {
  const count = fields.u32();
  if (count < 1 || count > population) bad(`${count} rows out of ${population} are listed`);
  const gaps = readVarints(fields, count);
  const rows = new Uint32Array(count);
  let row = -1;
  for (let i = 0; i < count; i++) {
    row += gaps[i] + 1;
    rows[i] = row;
  }
  // Rows rise, so none before the last is beyond it.
  if (row >= population) bad(`row ${row} is listed out of ${population}`);
  return rows;
}

function bad(message: string): never {
  refuse("bad-index-set", message);
}
