/** The state after a frame: integers on a lattice (SPEC section 5). */

import { ID_END } from "../container/limits";
import { offsetsOf } from "./groups";
import {
  addDifference,
  addId,
  addModulo,
  addSums,
  keysFrom,
  largestSummed,
  sumOfHashes,
  type Forms,
} from "./digest";
import type { Columns } from "../entropy/planes";

/** Room beyond what is there, so that Gaussians that are added rarely move all arrays. */
const SPARE = 1.125;

/** Rows that all groups are worked on for before the next ones: what one group fetches, the next one finds at hand. */
const BATCH = 1024;
const SIGN = -(2 ** 31);
/** Integers in a line of a processor's cache. */
const LINE = 16;

/** Ids of listed or added Gaussians, as two numbers of 32 bits each. */
export interface Ids {
  readonly low: Uint32Array;
  readonly high: Uint32Array;
}

/** Columns of each group, by its bit number; null for a group that is not present. */
export type GroupColumns = readonly (Columns | null)[];

/**
 * A state whose Gaussians keep their places in memory: `order` has the place of each row, and a Gaussian that is added
 * takes the place of one that goes. So a packet costs what it changes and not what there is.
 */
export class State {
  count = 0;
  frame = 0;
  nextId = 0n;
  /** The sum of all rows' hashes. */
  sum = 0n;
  /** Whether `order` says no more than that places are rows. */
  inOrder = true;
  order = new Uint32Array(0);
  idsLow = new Uint32Array(0);
  idsHigh = new Uint32Array(0);
  forms: Forms = { low: new Int32Array(0), high: new Int32Array(0) };
  /** Place after place, `width` integers each: those of all groups in bit order, so that they are fetched together. */
  integers = new Int32Array(0);
  readonly width: number;
  /** Where the channels of each group start among a place's integers. */
  readonly offsets: readonly number[];

  /** Keeps the compiler from leaving out what `fetch` does. */
  protected fetched = 0;

  constructor(readonly channels: readonly number[]) {
    this.offsets = offsetsOf(channels);
    this.width = channels.reduce((sum, count) => sum + count, 0);
  }

  /** A copy with room for so many Gaussians. */
  copy(capacity: number): State {
    const copy = new State(this.channels);
    copy.adopt(this, capacity);
    return copy;
  }

  reserve(count: number): void {
    if (count > this.order.length) this.adopt(this, Math.ceil(count * SPARE));
  }

  private adopt(from: State, wanted: number): void {
    const capacity = Math.max(wanted, from.count);
    const { count, frame, nextId, sum, inOrder } = from;
    Object.assign(this, { count, frame, nextId, sum, inOrder });
    this.order = resized(from.order, count, capacity);
    this.idsLow = resized(from.idsLow, count, capacity);
    this.idsHigh = resized(from.idsHigh, count, capacity);
    this.forms = { low: resized(from.forms.low, count, capacity), high: resized(from.forms.high, count, capacity) };
    this.integers = resized(from.integers, count * this.width, capacity * this.width);
  }

  placesOf(rows: Uint32Array): Uint32Array {
    if (this.inOrder) return rows;
    const places = new Uint32Array(rows.length);
    for (let i = 0; i < rows.length; i++) places[i] = this.order[rows[i]];
    return places;
  }

  /** The id of a row. */
  id(row: number): bigint {
    const place = this.order[row];
    return (BigInt(this.idsHigh[place]) << 32n) | BigInt(this.idsLow[place]);
  }

  /** Whether the next id is above every id and below 2^63. */
  get nextIdIsRight(): boolean {
    return this.nextId < ID_END && (this.count === 0 || this.id(this.count - 1) < this.nextId);
  }

  /** Adds residuals to the integers at these places (SPEC section 7, step 1). */
  change(places: Uint32Array, residuals: GroupColumns): void {
    for (let from = 0; from < places.length; from += BATCH) {
      const to = Math.min(from + BATCH, places.length);
      this.fetch(places, from, to);
      this.sum = addModulo(this.sum, -sumOfHashes(this.forms, places, from, to));
      residuals.forEach((columns, group) => {
        if (columns !== null) this.changeGroup(group, places, columns, from, to);
      });
      this.sum = addModulo(this.sum, sumOfHashes(this.forms, places, from, to));
    }
  }

  /**
   * Reads a batch's integers and forms once, for nothing but to have them at hand: loads that do not wait for each
   * other overlap, and a scene is larger than the processor's caches.
   */
  private fetch(places: Uint32Array, from: number, to: number): void {
    const { integers, width } = this;
    const { low, high } = this.forms;
    let any = 0;
    for (let i = from; i < to; i++) {
      const place = places[i] | 0;
      any ^= low[place] ^ high[place];
      const start = Math.imul(place, width);
      for (let at = start; at < start + width; at += LINE) any ^= integers[at];
    }
    this.fetched = any;
  }

  /**
   * Most of a decoder's time is here. Places are made signed, since indices computed from unsigned numbers are
   * floating-point numbers to the compiler.
   */
  private changeGroup(group: number, places: Uint32Array, columns: Columns, from: number, to: number): void {
    const { forms, integers, width } = this;
    const channels = this.channels[group];
    const offset = this.offsets[group];
    const [keysLow, keysHigh] = keysFrom(1 + offset, channels);
    const largest = largestSummed(channels);
    const beyond = -2 * largest;
    const rows = places.length | 0;
    for (let i = from; i < to; i++) {
      const place = places[i] | 0;
      const start = (Math.imul(place, width) + offset) | 0;
      let ofLow = 0;
      let ofHigh = 0;
      let odd = 0;
      for (let channel = 0, at = i; channel < channels; channel++, at = (at + rows) | 0) {
        const residual = columns[at];
        const before = integers[start + channel];
        const after = (before + residual) | 0;
        integers[start + channel] = after;
        ofLow += keysLow[channel] * residual;
        ofHigh = (ofHigh + Math.imul(keysHigh[channel], residual)) | 0;
        // Bits are set for a residual that is large, and, by its signs, for a sum that wraps around.
        odd |= ((residual + largest) & beyond) | ((before ^ after) & (residual ^ after) & SIGN);
      }
      if (odd === 0) addSums(forms, place, ofLow, ofHigh);
      else this.addOddRow(group, place, columns, i, rows);
    }
  }

  /** The form of a row that has changed by what `changeGroup` does not sum up exactly. */
  private addOddRow(group: number, place: number, columns: Columns, row: number, rows: number): void {
    const offset = this.offsets[group];
    for (let channel = 0; channel < this.channels[group]; channel++) {
      const after = this.integers[place * this.width + offset + channel];
      const before = (after - columns[channel * rows + row]) | 0;
      addDifference(this.forms, place, 1 + offset + channel, after, before);
    }
  }

  /** Writes Gaussians to places that hold nothing that counts. `sum` grows by their hashes. */
  write(places: Uint32Array, ids: Ids, values: GroupColumns): void {
    for (let from = 0; from < places.length; from += BATCH) {
      const to = Math.min(from + BATCH, places.length);
      this.writeIds(places, ids, from, to);
      values.forEach((columns, group) => {
        if (columns === null) this.clearGroup(group, places, from, to);
        else this.writeGroup(group, places, columns, from, to);
      });
      this.sum = addModulo(this.sum, sumOfHashes(this.forms, places, from, to));
    }
  }

  private writeIds(places: Uint32Array, ids: Ids, from: number, to: number): void {
    for (let i = from; i < to; i++) {
      const place = places[i];
      this.idsLow[place] = ids.low[i];
      this.idsHigh[place] = ids.high[i];
      this.forms.low[place] = 0;
      this.forms.high[place] = 0;
      addId(this.forms, place, ids.low[i], ids.high[i]);
    }
  }

  private writeGroup(group: number, places: Uint32Array, columns: Columns, from: number, to: number): void {
    const { forms, integers, width } = this;
    const channels = this.channels[group];
    const offset = this.offsets[group];
    const [keysLow, keysHigh] = keysFrom(1 + offset, channels);
    const largest = largestSummed(channels);
    const rows = places.length | 0;
    for (let i = from; i < to; i++) {
      const place = places[i] | 0;
      const start = (Math.imul(place, width) + offset) | 0;
      let ofLow = 0;
      let ofHigh = 0;
      for (let channel = 0, at = i; channel < channels; channel++, at = (at + rows) | 0) {
        const value = columns[at];
        integers[start + channel] = value;
        if (value < largest && value > -largest) {
          ofLow += keysLow[channel] * value;
          ofHigh = (ofHigh + Math.imul(keysHigh[channel], value)) | 0;
        } else {
          addDifference(forms, place, 1 + offset + channel, value, 0);
        }
      }
      addSums(forms, place, ofLow, ofHigh);
    }
  }

  private clearGroup(group: number, places: Uint32Array, from: number, to: number): void {
    for (let i = from; i < to; i++) {
      const start = this.width * places[i] + this.offsets[group];
      this.integers.fill(0, start, start + this.channels[group]);
    }
  }

  /** Copies the Gaussian at a place to another. */
  move(from: number, to: number): void {
    this.idsLow[to] = this.idsLow[from];
    this.idsHigh[to] = this.idsHigh[from];
    this.forms.low[to] = this.forms.low[from];
    this.forms.high[to] = this.forms.high[from];
    this.integers.copyWithin(this.width * to, this.width * from, this.width * (from + 1));
  }
}

function resized<T extends Int32Array | Uint32Array>(from: T, used: number, length: number): T {
  const made = new (from.constructor as new (length: number) => T)(length);
  made.set(from.subarray(0, used));
  return made;
}
