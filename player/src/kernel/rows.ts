/** Room for the Gaussians of a state, in the memory of a kernel of their own (kernel.c). */

import type { Lattice } from "../scene";
import { BATCH } from "./batch";
import { kernelInstance } from "./module";

/** The stored values of all Gaussians, slot after slot. */
export interface Floats {
  readonly means: Float32Array;
  readonly logScales: Float32Array;
  readonly quaternions: Float32Array;
  readonly opacityLogits: Float32Array;
  readonly sh: Float32Array;
}

interface Exports {
  readonly memory: WebAssembly.Memory;
  reserve(capacity: number, rest: number): number;
  places_at(): number;
  ids_at(): number;
  columns_at(): number;
  planes_at(): number;
  lattice_at(): number;
  forms_at(): number;
  integers_at(): number;
  floats_at(group: number): number;
  hashes(rows: number): bigint;
  unzigzag(column: number, planes: number, rows: number, constant: number, before: number): void;
  change(rows: number, present: number, sign: number): bigint;
  write(rows: number, present: number): bigint;
  move(from: number, to: number): void;
  dequantise(rows: number, present: number): void;
}

/** Memory of so many slots. It never grows, so that arrays stay what they are; what needs more room moves. */
export class Rows {
  readonly kernel: Exports;
  /** Slots of the batch, lower and upper halves of ids, and columns of `BATCH` integers, channel by channel. */
  readonly slots: Uint32Array;
  readonly idsLow: Uint32Array;
  readonly idsHigh: Uint32Array;
  readonly columns: Int32Array;
  /** Four planes of `BATCH` bytes, which `unzigzag` makes a column of. */
  readonly planes: Uint8Array;
  /** The linear forms of the digest, two numbers of 32 bits a slot. */
  readonly forms: Uint32Array;
  readonly integers: Int32Array;
  readonly floats: Floats;

  constructor(
    readonly capacity: number,
    channels: readonly number[],
    lattice: Lattice,
  ) {
    this.kernel = kernelInstance() as unknown as Exports;
    const { kernel } = this;
    const rest = channels[5];
    if (kernel.reserve(capacity, rest) === 0) throw new RangeError(`no memory for ${capacity} Gaussians`);
    const { buffer } = kernel.memory;
    const width = channels.reduce((sum, count) => sum + count, 0);
    this.slots = new Uint32Array(buffer, kernel.places_at(), BATCH);
    this.idsLow = new Uint32Array(buffer, kernel.ids_at(), BATCH);
    this.idsHigh = new Uint32Array(buffer, kernel.ids_at() + 4 * BATCH, BATCH);
    this.columns = new Int32Array(buffer, kernel.columns_at(), width * BATCH);
    this.planes = new Uint8Array(buffer, kernel.planes_at(), 4 * BATCH);
    this.forms = new Uint32Array(buffer, kernel.forms_at(), 2 * capacity);
    this.integers = new Int32Array(buffer, kernel.integers_at(), width * capacity);
    const floats = (group: number, count: number): Float32Array =>
      new Float32Array(buffer, kernel.floats_at(group), count * capacity);
    this.floats = {
      means: floats(0, 3),
      logScales: floats(1, 3),
      quaternions: floats(2, 4),
      opacityLogits: floats(3, 1),
      sh: floats(4, 3 + rest),
    };
    new Float64Array(buffer, kernel.lattice_at(), 11).set(stepsOf(lattice));
  }

  /** Takes over the first so many slots of others; their floats only where `withFloats`. */
  adopt(from: Rows, count: number, withFloats: boolean): void {
    const width = from.integers.length / Math.max(1, from.capacity);
    this.forms.set(from.forms.subarray(0, 2 * count));
    this.integers.set(from.integers.subarray(0, width * count));
    if (!withFloats) return;
    for (const name of Object.keys(this.floats) as (keyof Floats)[]) {
      const each = from.floats[name].length / Math.max(1, from.capacity);
      this.floats[name].set(from.floats[name].subarray(0, each * count));
    }
  }
}

function stepsOf({ means, origin, logScales, quaternions, opacityLogits, shDc, shRest }: Lattice): number[] {
  return [...means, ...origin, logScales, quaternions, opacityLogits, shDc, shRest];
}
