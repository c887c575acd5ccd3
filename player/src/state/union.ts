/**
 * A base and what refines it, as one state (SPEC section 7, "Layers"): the base's rows with the values that they have in
 * the whole scene, behind them those of the layer above.
 */
import { refuse } from "../container/errors";
import { Fields } from "../container/fields";
import { LAYER_IDS, type Refinement } from "../container/layers";
import type { Limits } from "../container/limits";
import { allRows, rowsBetween } from "../entropy/rising";
import type { FrameKind, Gaussians, StreamHeader } from "../scene";
import { readCorrections } from "./corrections";
import { ALL_GROUPS, Decoder, ROOM, changeState, checkDigest, concatenated, distinct, gaussiansOf, type FramePacket, type Step } from "./decoder";
import { channelsOf } from "./groups";
import { checkCount, consecutiveIds, readDelta } from "./payloads";
import { State } from "./state";

/** What a frame did to all layers; cameras are the base's. */
export type UnionStep = Omit<Step, "corrections">;

interface Block {
  count: number;
  nextId: bigint;
}

/** By how much the first keyframe's rows of the base differ in the whole scene: its rows by id, a column after the other. */
interface Offsets {
  readonly rows: ReadonlyMap<bigint, number>;
  readonly columns: readonly Int32Array[];
}

const NO_SLOTS = new Uint32Array(0);

export class Union {
  private readonly channels: readonly number[];
  private state: State | null = null;
  private blocks: [Block, Block] = [{ count: 0, nextId: 0n }, { count: 0, nextId: LAYER_IDS }];
  /** The first keyframe, for those that refer to it. */
  private firsts: { readonly base: Uint8Array; readonly refinement: Refinement } | null = null;
  private firstOffsets: Offsets | null = null;

  constructor(
    private readonly header: StreamHeader,
    private readonly limits: Limits,
  ) {
    this.channels = channelsOf(header.shDegree);
  }

  /** The frame whose scene this is; null where a keyframe must come. */
  get frame(): number | null {
    return this.state?.frame ?? null;
  }

  get gaussians(): Gaussians | null {
    return this.state === null ? null : gaussiansOf(this.state);
  }

  get hasFirst(): boolean {
    return this.firsts !== null;
  }

  /** Keeps the first keyframe for others that refer to it. */
  keepFirst(base: Uint8Array, refinement: Refinement): void {
    const { block, alignments } = refinement;
    this.firsts ??= { base: base.slice(), refinement: { ...refinement, block: block.slice(), alignments: alignments.map((each) => each.slice()) } };
  }

  /** Whether a keyframe needs the first one. */
  refersToFirst(base: FramePacket, { block }: Refinement): boolean {
    const [low, high] = this.decoders();
    return low.refersToFirst(base.payload) || high.refersToFirst(block);
  }

  /** A frame of no use any more: a keyframe must come. */
  forget(): void {
    this.state = null;
  }

  /** Goes on to a frame. One that is refused leaves nothing: a keyframe must come then. Raises StreamError. */
  apply(base: FramePacket, refinement: Refinement | null): UnionStep {
    const before = this.state;
    this.state = null;
    const [state, step] = base.kind === "key" ? this.key(base, refinement) : this.next(base, refinement, before);
    state.frame = base.frame;
    this.state = state;
    return step;
  }

  private decoders(): [Decoder, Decoder] {
    return [new Decoder(this.header, this.limits), new Decoder({ ...this.header, corrected: new Map() }, this.limits)];
  }

  private key(base: FramePacket, refinement: Refinement | null): [State, UnionStep] {
    if (refinement?.kind !== "key") refuse("missing-key", `the keyframe at frame ${base.frame} lacks its refinement`);
    if (base.frame === 0) this.keepFirst(base.payload, refinement);
    const [below, above] = this.decoders();
    if (this.firsts !== null) {
      below.keepFirst(this.firsts.base);
      above.keepFirst(this.firsts.refinement.block);
    }
    below.apply(base, true);
    above.apply({ kind: "key", frame: base.frame, payload: refinement.block }, true);
    const [low, high] = [below.integers!, above.integers!];
    checkIds(high);
    checkCount(low.count + high.count, this.limits.gaussians);
    const state = new State(this.channels, this.header.lattice, Math.ceil((low.count + high.count) * ROOM));
    state.copyFrom(low);
    append(state, high);
    this.blocks = [low, high].map(({ count, nextId }) => ({ count, nextId })) as [Block, Block];
    if (base.frame > 0 && below.refersToFirst(base.payload)) this.alignAsInFirst(state);
    this.align(state, refinement);
    this.check(state, refinement);
    state.dequantise(allRows(state.count), ALL_GROUPS);
    return [state, { slots: null, changed: 0, added: state.count, removed: 0 }];
  }

  private next(base: FramePacket, refinement: Refinement | null, state: State | null): [State, UnionStep] {
    if (state === null) refuse("missing-key", `frame ${base.frame} needs a keyframe before it`);
    if (base.frame !== state.frame + 1) refuse("frame-order", `frame ${base.frame} follows frame ${state.frame}`);
    if (refinement === null) {
      if (base.kind !== "skip") refuse("missing-key", `frame ${base.frame} lacks its refinement`);
      return [state, { slots: NO_SLOTS, changed: 0, added: 0, removed: 0 }];
    }
    const fields = new Fields(base.payload);
    readCorrections(fields, this.header);
    const steps = [this.step(state, 0, base.kind, fields), this.step(state, 1, refinement.kind, new Fields(refinement.block))];
    const aligned = this.align(state, refinement);
    this.check(state, refinement);
    const slots = distinct(concatenated(...steps.map((step) => step.slots ?? NO_SLOTS), aligned), state.count);
    state.dequantise(slots, ALL_GROUPS);
    const sum = (name: "changed" | "added" | "removed"): number => steps[0][name] + steps[1][name];
    return [state, { slots, changed: sum("changed"), added: sum("added"), removed: sum("removed") }];
  }

  /** A block's own packet. */
  private step(state: State, number: 0 | 1, kind: FrameKind, fields: Fields): UnionStep {
    if (kind === "key") refuse("frame-order", "a keyframe's refinement has no keyframe");
    if (kind === "skip") return { slots: NO_SLOTS, changed: 0, added: 0, removed: 0 };
    const block = this.blocks[number];
    const others = this.blocks[1 - number].count;
    fields.u64(); // the digest of what this reader need not have
    const delta = readDelta(fields, { ...block, channels: this.channels }, this.limits.gaussians - others);
    const { added, removed, values } = delta;
    const nextId = block.nextId + BigInt(added);
    const from = number === 0 ? 0 : this.blocks[0].count;
    const { slots, moved } = changeState(state, delta, consecutiveIds(block.nextId, added), values, nextId, null, from, from + block.count);
    Object.assign(block, { count: block.count + added - removed.length, nextId });
    return { slots: concatenated(slots.touched, slots.taken, moved), changed: delta.touched.length, added, removed: removed.length };
  }

  /** The base's rows as the whole scene has them; returns the slots of those that this frame says it of. */
  private align(state: State, { alignments }: Refinement): Uint32Array {
    if (alignments.length !== 1 || alignments[0].length === 0) return NO_SLOTS;
    const fields = new Fields(alignments[0]);
    fields.u64();
    const { touched, residuals, removed, added } = readDelta(fields, { ...this.blocks[0], channels: this.channels }, this.limits.gaussians);
    if (removed.length > 0 || added > 0) refuse("bad-payload", "an alignment adds or removes Gaussians");
    const slots = state.placesOf(touched);
    state.change(slots, residuals);
    return slots;
  }

  /** A keyframe's rows of the base that are in the first keyframe, too, have the offsets of there. */
  private alignAsInFirst(state: State): void {
    const { rows, columns } = (this.firstOffsets ??= this.offsetsOfFirst());
    const here: [number, number][] = [];
    for (let row = 0; row < this.blocks[0].count; row++) {
      const first = rows.get(state.id(row));
      if (first !== undefined) here.push([row, first]);
    }
    const all = rows.size;
    const residuals = this.channels.map((channels, group) => {
      const values = new Int32Array(channels * here.length);
      for (let channel = 0; channel < channels; channel++) {
        here.forEach(([, first], place) => (values[channel * here.length + place] = columns[group][channel * all + first]));
      }
      return channels === 0 ? null : values;
    });
    state.change(state.placesOf(Uint32Array.from(here, ([row]) => row)), residuals);
  }

  private offsetsOfFirst(): Offsets {
    const { base, refinement } = this.firsts!;
    const [decoder] = this.decoders();
    decoder.apply({ kind: "key", frame: 0, payload: base }, true);
    const own = decoder.integers!;
    const aligned = new State(this.channels, this.header.lattice, own.count);
    aligned.copyFrom(own);
    const { blocks } = this;
    this.blocks = [{ count: own.count, nextId: own.nextId }, blocks[1]];
    this.align(aligned, refinement);
    this.blocks = blocks;
    const rows = new Map(Array.from({ length: own.count }, (_, row) => [own.id(row), row]));
    const columns = this.channels.map((channels, group) => {
      const values = new Int32Array(channels * own.count);
      for (let channel = 0; channel < channels; channel++) {
        for (let row = 0; row < own.count; row++) {
          const at = own.width * own.order[row] + own.offsets[group] + channel;
          values[channel * own.count + row] = aligned.integers[at] - own.integers[at];
        }
      }
      return values;
    });
    return { rows, columns };
  }

  private check(state: State, { digest, layer }: Refinement): void {
    if (layer !== 1) refuse("unsupported-mode", `layer ${layer} is above those that this player joins`);
    checkDigest(state.sum, state.count, this.blocks[1].nextId, digest);
  }
}

function checkIds(state: State): void {
  const low = state.count > 0 ? state.id(0) : LAYER_IDS;
  if (low < LAYER_IDS || state.nextId < LAYER_IDS || state.nextId > 2n * LAYER_IDS) refuse("bad-payload", "ids of a layer are another layer's");
}

/** Puts another state's Gaussians behind the last row. */
function append(state: State, from: State): void {
  const { count } = from;
  const rows = from.order.subarray(0, count);
  const ids = { low: new Uint32Array(count), high: new Uint32Array(count) };
  rows.forEach((slot, row) => {
    ids.low[row] = from.idsLow[slot];
    ids.high[row] = from.idsHigh[slot];
  });
  const columns = from.channels.map((channels, group) => {
    const values = new Int32Array(channels * count);
    for (let channel = 0; channel < channels; channel++) {
      const column = from.offsets[group] + channel;
      for (let row = 0; row < count; row++) values[channel * count + row] = from.integers[rows[row] * from.width + column];
    }
    return channels === 0 ? null : values;
  });
  const first = state.count;
  state.reserve(first + count);
  state.writeBehind(ids, columns);
  state.order.set(rowsBetween(first, first + count), first);
  state.count = first + count;
}
