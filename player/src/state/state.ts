/** The state after a frame: integers on a lattice (SPEC section 5). */

import { ID_END } from "../container/limits";
import { GROUPS, firstKeys } from "./groups";
import { addId, addModulo, addProduct, addWrap, sumOfHashes, type Forms } from "./digest";
import type { Columns } from "../entropy/planes";

/** Room beyond what is there, so that Gaussians that are added rarely move all arrays. */
const SPARE = 1.125;

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
  /** By group: place after place, its channels. */
  readonly integers: Int32Array[] = Array.from({ length: GROUPS }, () => new Int32Array(0));
  private readonly keys: readonly number[];

  constructor(readonly channels: readonly number[]) {
    this.keys = firstKeys(channels);
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
    this.channels.forEach((channels, group) => {
      this.integers[group] = resized(from.integers[group], count * channels, capacity * channels);
    });
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

  /** Adds residuals to the integers at these places, or takes them off again (SPEC section 7, step 1). */
  change(places: Uint32Array, residuals: GroupColumns, sign: 1 | -1 = 1): void {
    this.sum = addModulo(this.sum, -sumOfHashes(this.forms, places));
    residuals.forEach((columns, group) => {
      if (columns === null) return;
      for (let channel = 0; channel < this.channels[group]; channel++) {
        const column = columns.subarray(channel * places.length, (channel + 1) * places.length);
        this.changeChannel(group, channel, places, column, sign);
      }
    });
    this.sum = addModulo(this.sum, sumOfHashes(this.forms, places));
  }

  private changeChannel(group: number, channel: number, places: Uint32Array, column: Int32Array, sign: number): void {
    const integers = this.integers[group];
    const channels = this.channels[group];
    const key = this.keys[group] + channel;
    const { forms } = this;
    for (let i = 0; i < places.length; i++) {
      const residual = (column[i] * sign) | 0;
      if (residual === 0) continue;
      const at = places[i] * channels + channel;
      const exact = integers[at] + residual;
      const wrapped = exact | 0;
      integers[at] = wrapped;
      addProduct(forms, places[i], key, residual);
      if (wrapped !== exact) addWrap(forms, places[i], key, exact > wrapped);
    }
  }

  /** Writes Gaussians to places that hold nothing that counts. `sum` grows by their hashes. */
  write(places: Uint32Array, ids: Ids, values: GroupColumns): void {
    for (let i = 0; i < places.length; i++) {
      const place = places[i];
      this.idsLow[place] = ids.low[i];
      this.idsHigh[place] = ids.high[i];
      this.forms.low[place] = 0;
      this.forms.high[place] = 0;
      addId(this.forms, place, ids.low[i], ids.high[i]);
    }
    values.forEach((columns, group) => {
      for (let channel = 0; channel < this.channels[group]; channel++) {
        this.writeChannel(group, channel, places, columns);
      }
    });
    this.sum = addModulo(this.sum, sumOfHashes(this.forms, places));
  }

  /** Copies the Gaussian at a place to another. */
  move(from: number, to: number): void {
    this.idsLow[to] = this.idsLow[from];
    this.idsHigh[to] = this.idsHigh[from];
    this.forms.low[to] = this.forms.low[from];
    this.forms.high[to] = this.forms.high[from];
    this.channels.forEach((channels, group) => {
      this.integers[group].copyWithin(channels * to, channels * from, channels * (from + 1));
    });
  }

  private writeChannel(group: number, channel: number, places: Uint32Array, columns: Columns | null): void {
    const integers = this.integers[group];
    const channels = this.channels[group];
    const key = this.keys[group] + channel;
    const { forms } = this;
    const start = channel * places.length;
    for (let i = 0; i < places.length; i++) {
      const value = columns === null ? 0 : columns[start + i];
      integers[places[i] * channels + channel] = value;
      if (value !== 0) addProduct(forms, places[i], key, value);
    }
  }
}

function resized<T extends Int32Array | Uint32Array>(from: T, used: number, length: number): T {
  const made = new (from.constructor as new (length: number) => T)(length);
  made.set(from.subarray(0, used));
  return made;
}
