/** The state after a frame: integers on a lattice (SPEC section 5). */

import { ID_END } from "../container/limits";
import type { Columns, Planes } from "../entropy/planes";
import { BATCH } from "../kernel/batch";
import { Rows, type Floats } from "../kernel/rows";
import type { Lattice } from "../scene";
import { addModulo } from "./digest";
import { offsetsOf } from "./groups";
import { rowsBetween } from "../entropy/rising";

/** Room beyond what is there, so that Gaussians that are added rarely move all arrays. */
const SPARE = 1.125;

/** Ids of listed or added Gaussians, as two numbers of 32 bits each. */
export interface Ids {
  readonly low: Uint32Array;
  readonly high: Uint32Array;
}

/** What a packet tells of each group, by its bit number; null for a group that is not present. */
export type Groups = readonly (Columns | Planes | null)[];

/**
 * A state whose Gaussians keep their slots in memory: `order` has the slot of each row, and a Gaussian that is added
 * takes the slot of one that goes. So a packet costs what it changes and not what there is.
 */
export class State {
  count = 0;
  frame = 0;
  nextId = 0n;
  /** The sum of all rows' hashes. */
  sum = 0n;
  /** Whether `order` says no more than that slots are rows. */
  inOrder = true;
  order = new Uint32Array(0);
  idsLow = new Uint32Array(0);
  idsHigh = new Uint32Array(0);
  readonly width: number;
  /** Where the channels of each group start among a slot's integers. */
  readonly offsets: readonly number[];
  private rows: Rows;

  constructor(
    readonly channels: readonly number[],
    private readonly lattice: Lattice,
    capacity: number,
  ) {
    this.offsets = offsetsOf(channels);
    this.width = channels.reduce((sum, count) => sum + count, 0);
    this.rows = new Rows(capacity, channels, lattice);
    this.reserveIds(capacity);
  }

  /** Slot after slot, `width` integers each: those of all groups in bit order, so that they are fetched together. */
  get integers(): Int32Array {
    return this.rows.integers;
  }

  /** The stored values, where `dequantise` has been told to put them. */
  get floats(): Floats {
    return this.rows.floats;
  }

  get capacity(): number {
    return this.rows.capacity;
  }

  /** Becomes empty; what memory there is stays. */
  clear(): void {
    Object.assign(this, { count: 0, frame: 0, nextId: 0n, sum: 0n, inOrder: true });
  }

  /** Becomes what another state is, but for its floats; that one has no more Gaussians than this has room for. */
  copyFrom(from: State): void {
    const { count, frame, nextId, sum, inOrder } = from;
    Object.assign(this, { count, frame, nextId, sum, inOrder });
    this.order.set(from.order.subarray(0, count));
    this.idsLow.set(from.idsLow.subarray(0, count));
    this.idsHigh.set(from.idsHigh.subarray(0, count));
    this.rows.adopt(from.rows, count, false);
  }

  reserve(count: number): void {
    if (count <= this.capacity) return;
    const rows = new Rows(Math.ceil(count * SPARE), this.channels, this.lattice);
    rows.adopt(this.rows, this.count, true);
    this.rows = rows;
    this.reserveIds(rows.capacity);
  }

  private reserveIds(capacity: number): void {
    this.order = resized(this.order, this.count, capacity);
    this.idsLow = resized(this.idsLow, this.count, capacity);
    this.idsHigh = resized(this.idsHigh, this.count, capacity);
  }

  placesOf(rows: Uint32Array): Uint32Array {
    if (this.inOrder) return rows;
    const slots = new Uint32Array(rows.length);
    for (let i = 0; i < rows.length; i++) slots[i] = this.order[rows[i]];
    return slots;
  }

  /** The id of a row. */
  id(row: number): bigint {
    const slot = this.order[row];
    return (BigInt(this.idsHigh[slot]) << 32n) | BigInt(this.idsLow[slot]);
  }

  /** Whether the next id is above every id and below 2^63. */
  get nextIdIsRight(): boolean {
    return this.nextId < ID_END && (this.count === 0 || this.id(this.count - 1) < this.nextId);
  }

  /** The sum of the hashes of the Gaussians at these slots. */
  sumOfHashes(slots: Uint32Array): bigint {
    let sum = 0n;
    this.inBatches(slots, (rows) => {
      sum = addModulo(sum, this.rows.kernel.hashes(rows));
    });
    return sum;
  }

  /** Adds residuals to the integers at these slots (SPEC section 7, step 1), or takes them back, modulo 2^32. */
  change(slots: Uint32Array, residuals: Groups, back = false): void {
    const present = presence(residuals);
    this.inBatches(slots, (rows, from) => {
      this.setColumns(residuals, slots.length, rows, from);
      this.sum = addModulo(this.sum, this.rows.kernel.change(rows, present, back ? -1 : 1));
    });
  }

  /** Writes Gaussians to the slots behind the last one, which counts nothing yet. `sum` grows by their hashes. */
  writeBehind(ids: Ids, values: Groups): void {
    const { count } = this;
    const added = ids.low.length;
    const present = presence(values);
    this.idsLow.set(ids.low, count);
    this.idsHigh.set(ids.high, count);
    this.inBatches(rowsBetween(count, count + added), (rows, from) => {
      this.setColumns(values, added, rows, from);
      this.rows.idsLow.set(ids.low.subarray(from, from + rows));
      this.rows.idsHigh.set(ids.high.subarray(from, from + rows));
      this.sum = addModulo(this.sum, this.rows.kernel.write(rows, present));
    });
  }

  /** Puts the Gaussians at these slots on the lattice; only the groups whose bits are set. */
  dequantise(slots: Uint32Array, present: number): void {
    this.inBatches(slots, (rows) => {
      this.rows.kernel.dequantise(rows, present);
    });
  }

  /** Copies the Gaussian at a slot to another. */
  move(from: number, to: number): void {
    this.idsLow[to] = this.idsLow[from];
    this.idsHigh[to] = this.idsHigh[from];
    this.rows.kernel.move(from, to);
  }

  private inBatches(slots: Uint32Array, work: (rows: number, from: number) => void): void {
    for (let from = 0; from < slots.length; from += BATCH) {
      const batch = slots.subarray(from, from + BATCH);
      this.rows.slots.set(batch);
      work(batch.length, from);
    }
  }

  /** Puts the batch's part of all columns where the kernel takes it. */
  private setColumns(groups: Groups, all: number, rows: number, from: number): void {
    groups.forEach((columns, group) => {
      if (columns === null) return;
      for (let channel = 0; channel < this.channels[group]; channel++) {
        const column = this.offsets[group] + channel;
        if (!(columns instanceof Int32Array)) this.setPlanes(columns, channel, column, rows, from);
        else this.rows.columns.set(columns.subarray(channel * all + from, channel * all + from + rows), BATCH * column);
      }
    });
  }

  private setPlanes(group: Planes, channel: number, column: number, rows: number, from: number): void {
    const { kernel, planes } = this.rows;
    const starts = group.starts[channel];
    starts.forEach((start, plane) => {
      planes.set(group.block.subarray(start + from, start + from + rows), BATCH * plane);
    });
    const before = group.channelBefore && channel > 0 ? 1 : 0;
    kernel.unzigzag(column, starts.length, rows, group.constants[channel], before);
  }
}

/** A bit for each group that is told of. */
export function presence(groups: Groups): number {
  return groups.reduce((bits, columns, group) => (columns === null ? bits : bits | (1 << group)), 0);
}

function resized(from: Uint32Array<ArrayBuffer>, used: number, length: number): Uint32Array<ArrayBuffer> {
  const made = new Uint32Array(length);
  made.set(from.subarray(0, used));
  return made;
}
