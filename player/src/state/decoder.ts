/** Frame by frame (SPEC section 7): a packet's payload, and the scene that it leads to. */

import { refuse } from "../container/errors";
import { Fields } from "../container/fields";
import type { Limits } from "../container/limits";
import type { CameraCorrection, FrameKind, Gaussians, StreamHeader } from "../scene";
import { readCorrections } from "./corrections";
import { addModulo, combine } from "./digest";
import { channelsOf } from "./groups";
import {
  consecutiveIds,
  readDelta,
  readKeyBody,
  readKeyHead,
  type Changes,
  type KeyBody,
  type KeyHead,
} from "./payloads";
import { closeUp, slotsForNew } from "./slots";
import { allRows } from "../entropy/rising";
import { State, presence, type Groups, type Ids } from "./state";

export interface FramePacket {
  readonly kind: FrameKind;
  readonly frame: number;
  readonly payload: Uint8Array;
}

/** What a packet did to the scene. */
export interface Step {
  /** Slots whose values may have changed, each once; null for all. */
  readonly slots: Uint32Array | null;
  readonly changed: number;
  readonly added: number;
  readonly removed: number;
  readonly corrections: ReadonlyMap<string, CameraCorrection>;
}

const NO_SLOTS = new Uint32Array(0);
export const ALL_GROUPS = 0b111111;
/** Room in a keyframe's memory: what the next frames add, and the next keyframe, which is built in it. */
export const ROOM = 1.0625;
const REFERENCE_OFFSET = 20;
const NO_FLOATS = new Float32Array(0);
const NO_GAUSSIANS: Gaussians = {
  count: 0,
  means: NO_FLOATS,
  logScales: NO_FLOATS,
  quaternions: NO_FLOATS,
  opacityLogits: NO_FLOATS,
  sh: NO_FLOATS,
  order: null,
};

/**
 * The scene, as packets change it. A packet that is refused leaves it as it was: payloads are read whole before they
 * are applied, and the digest is verified before anything moves or goes.
 */
export class Decoder {
  private readonly channels: readonly number[];
  private state: State | null = null;
  /** The state before the last keyframe: the next one is built in its memory. */
  private spare: State | null = null;
  /** The first keyframe's payload, and its state from the time that a keyframe refers to it. */
  private firstPayload: Uint8Array | null = null;
  private first: State | null = null;

  constructor(
    private readonly header: StreamHeader,
    private readonly limits: Limits,
  ) {
    this.channels = channelsOf(header.shDegree);
  }

  /** The frame whose state this is; null before the first. */
  get frame(): number | null {
    return this.state?.frame ?? null;
  }

  get gaussians(): Gaussians {
    const { state } = this;
    if (state === null) return NO_GAUSSIANS;
    return gaussiansOf(state);
  }

  /** The state itself: whoever takes it does not change it. */
  get integers(): State | null {
    return this.state;
  }

  get hasFirst(): boolean {
    return this.firstPayload !== null;
  }

  /** Keeps the first keyframe's payload for keyframes that refer to it. */
  keepFirst(payload: Uint8Array): void {
    this.firstPayload ??= payload.slice();
  }

  /** Whether a key packet refers to the first keyframe. */
  refersToFirst(payload: Uint8Array): boolean {
    const fields = new Fields(payload);
    readCorrections(fields, this.header);
    fields.take(REFERENCE_OFFSET);
    return fields.u8() === 1;
  }

  /**
   * Goes on with the packet of the next frame, or with any keyframe where frames were passed over (`jump`).
   * Raises StreamError.
   */
  apply(packet: FramePacket, jump = false): Step {
    const { state } = this;
    if (packet.kind !== "key" && state === null) refuse("missing-key", `frame ${packet.frame} needs a keyframe before it`);
    const expected = state === null ? 0 : state.frame + 1;
    if (packet.frame !== expected && !(jump && packet.kind === "key")) {
      refuse("frame-order", `frame ${packet.frame} comes where frame ${expected} must`);
    }
    const fields = new Fields(packet.payload);
    const corrections = readCorrections(fields, this.header);
    return { ...this.reconstruct(packet, fields, state), corrections };
  }

  private reconstruct(packet: FramePacket, fields: Fields, state: State | null): Omit<Step, "corrections"> {
    if (packet.kind === "key" || state === null) return this.applyKey(packet, fields);
    const step = packet.kind === "delta" ? this.applyDelta(state, fields) : applySkip(state, fields);
    state.frame = packet.frame;
    return step;
  }

  private applyDelta(state: State, fields: Fields): Omit<Step, "corrections"> {
    const digest = fields.u64();
    const delta = readDelta(fields, state, this.limits.gaussians);
    const { added, removed, values } = delta;
    const ids = consecutiveIds(state.nextId, added);
    const { slots, moved } = changeState(state, delta, ids, values, state.nextId + BigInt(added), digest);
    state.dequantise(slots.touched, presence(delta.residuals));
    state.dequantise(concatenated(slots.taken, moved), ALL_GROUPS);
    const all = distinct(concatenated(slots.touched, slots.taken, moved), state.count);
    return { slots: all, changed: delta.touched.length, added, removed: removed.length };
  }

  private applyKey(packet: FramePacket, fields: Fields): Omit<Step, "corrections"> {
    const digest = fields.u64();
    const head = readKeyHead(fields, this.limits.gaussians);
    const first = head.refers ? this.firstState() : null;
    const body = readKeyBody(fields, head, first, this.channels);
    const state = this.spareState((first?.count ?? 0) + body.ids.low.length);
    if (first !== null) state.copyFrom(first);
    buildKey(state, head, body, digest);
    state.frame = packet.frame;
    if (packet.frame === 0) this.keepFirst(packet.payload);
    this.spare = this.state;
    this.state = state;
    state.dequantise(allRows(state.count), ALL_GROUPS);
    return { slots: null, ...keyCounts(head, body) };
  }

  private firstState(): State {
    if (this.first !== null) return this.first;
    if (this.firstPayload === null) refuse("missing-key", "a keyframe refers to the stream's first one, which is missing");
    const fields = new Fields(this.firstPayload);
    readCorrections(fields, this.header);
    const digest = fields.u64();
    const head = readKeyHead(fields, this.limits.gaussians);
    if (head.refers) refuse("missing-key", "the stream's first keyframe refers to itself");
    const state = new State(this.channels, this.header.lattice, head.count);
    buildKey(state, head, readKeyBody(fields, head, null, this.channels), digest);
    this.first = state;
    return state;
  }

  /** An empty state with room for so many Gaussians; as long as it is not this decoder's, it may be spoilt. */
  private spareState(count: number): State {
    if (this.spare === null || this.spare.capacity < count) {
      this.spare = null;
      this.spare = new State(this.channels, this.header.lattice, Math.ceil(count * ROOM));
    }
    this.spare.clear();
    return this.spare;
  }
}

export function gaussiansOf(state: State): Gaussians {
  const { count, inOrder, floats } = state;
  return { count, ...floats, order: inOrder ? null : state.order.subarray(0, count) };
}

function applySkip(state: State, fields: Fields): Omit<Step, "corrections"> {
  const digest = fields.u64();
  fields.finish();
  checkDigest(state.sum, state.count, state.nextId, digest);
  return { slots: NO_SLOTS, changed: 0, added: 0, removed: 0 };
}

/** Turns an empty state, or a copy of the first keyframe's, into a keyframe's. */
function buildKey(state: State, head: KeyHead, { changes, ids, values }: KeyBody, digest: bigint): void {
  const nothing: Changes = { touched: NO_SLOTS, residuals: [], removed: NO_SLOTS };
  changeState(state, changes ?? nothing, ids, values, head.nextId, digest);
}

export interface Changed {
  readonly slots: { readonly touched: Uint32Array; readonly taken: Uint32Array };
  readonly moved: Uint32Array;
}

/**
 * Steps 1 to 3 of SPEC section 7, of the rows `from` up to `end`; a state whose digest is another afterwards is as before,
 * and refused. `digest` null: it is compared later, and `nextId` is of these rows alone.
 */
export function changeState(
  state: State,
  { touched: touchedRows, residuals, removed: removedRows }: Changes,
  ids: Ids,
  values: Groups,
  nextId: bigint,
  digest: bigint | null,
  from = 0,
  end = state.count,
): Changed {
  const added = ids.low.length;
  const removed = shifted(removedRows, from);
  const touched = state.placesOf(shifted(touchedRows, from));
  const freed = state.placesOf(removed);
  const { sum } = state;
  state.reserve(state.count + added);
  state.change(touched, residuals);
  state.sum = addModulo(state.sum, -state.sumOfHashes(freed));
  // Beyond the last slot until the digest is verified: the removed ones may have to stay.
  state.writeBehind(ids, values);
  try {
    const lastId = added > 0 ? idOf(ids, added - 1) : lastKeptId(state, removed, from, end);
    if (lastId >= nextId) refuse("bad-payload", "the next id is not above all ids");
    if (digest !== null) checkDigest(state.sum, state.count - removed.length + added, nextId, digest);
  } catch (error) {
    state.change(touched, residuals, true);
    state.sum = sum;
    throw error;
  }
  const taken = slotsForNew(state, freed, added);
  if (freed.length > 0) for (let i = 0; i < added; i++) state.move(state.count + i, taken[i]);
  const move = (slot: number, to: number): void => {
    state.move(slot, to);
  };
  const moved = closeUp(state, removed, freed, taken, move, end);
  if (digest !== null) state.nextId = nextId;
  return { slots: { touched, taken }, moved };
}

function idOf({ low, high }: Ids, i: number): bigint {
  return (BigInt(high[i]) << 32n) | BigInt(low[i]);
}

function shifted(rows: Uint32Array, by: number): Uint32Array {
  return by === 0 ? rows : rows.map((row) => row + by);
}

/** The id of the last row that is not removed; -1 when none is left. */
function lastKeptId(state: State, removed: Uint32Array, from: number, end: number): bigint {
  let row = end - 1;
  for (let i = removed.length - 1; i >= 0 && removed[i] === row; i--) row--;
  return row < from ? -1n : state.id(row);
}

export function checkDigest(sum: bigint, count: number, nextId: bigint, expected: bigint): void {
  if (combine(sum, count, nextId) !== expected) {
    refuse("digest-mismatch", "the reconstructed state is not the encoder's");
  }
}

function keyCounts({ count, refers }: KeyHead, { changes, ids }: KeyBody): Pick<Step, "changed" | "added" | "removed"> {
  if (!refers || changes === null) return { changed: 0, added: count, removed: 0 };
  return { changed: changes.touched.length, added: ids.low.length, removed: changes.removed.length };
}

export function concatenated(...parts: Uint32Array[]): Uint32Array {
  const joined = new Uint32Array(parts.reduce((length, part) => length + part.length, 0));
  let position = 0;
  for (const part of parts) {
    joined.set(part, position);
    position += part.length;
  }
  return joined;
}

/** Slots below the count, each once. */
export function distinct(slots: Uint32Array, count: number): Uint32Array {
  const seen = new Uint8Array(count);
  let kept = 0;
  for (let i = 0; i < slots.length; i++) {
    const slot = slots[i];
    if (slot >= count || seen[slot] !== 0) continue;
    seen[slot] = 1;
    slots[kept++] = slot;
  }
  return slots.subarray(0, kept);
}
