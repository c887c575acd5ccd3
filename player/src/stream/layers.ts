/** Frames with all that refines them, as far as it has come: the base plays without. */
import { StreamError, isDamage, refuse } from "../container/errors";
import { readRefinement, type Refinement } from "../container/layers";
import type { Limits } from "../container/limits";
import { KIND, PACKET_HEADER_BYTES, readPacketHeader, readPayload } from "../container/packets";
import type { Budget } from "../messages";
import type { Gaussians, StreamHeader } from "../scene";
import type { FramePacket } from "../state/decoder";
import { Union, type UnionStep } from "../state/union";
import { Ages } from "./ages";
import { Changes } from "./changes";
import type { FrameTable, Place } from "./frameTable";
import { isRefined } from "./heldFrames";
import type { ByteSource } from "./sources";

/** What has changed with the frame that was reached. */
export interface Refined {
  readonly gaussians: Gaussians;
  readonly changedRows: Uint32Array | null;
  readonly step: UnionStep;
}

/** As players take it where a stream does not say. */
export const USUAL_FPS = 30;
/** Bytes of refinements: the base may be due before they have come. */
const READ_AT_ONCE = 1 << 17;
const NOTHING: UnionStep = { slots: new Uint32Array(0), changed: 0, added: 0, removed: 0 };

export class Layers {
  /** What is wrong with refinements; the base plays on. */
  readonly notices: StreamError[] = [];
  /** What may be held and may come. */
  budget: Budget = {};
  private readonly union: Union;
  private reading = false;
  private readonly changes = new Changes();
  private readonly ages = new Ages();
  /** The segment, by its keyframe, whose refinements are damaged, and from which frame on. */
  private damaged = { key: -1, from: 0 };

  constructor(
    private readonly source: ByteSource,
    private readonly header: StreamHeader,
    private readonly limits: Limits,
  ) {
    this.union = new Union(header, limits);
  }

  /** Whether all layers are within what may be held and may come. */
  get wanted(): boolean {
    const { layers, fps } = this.header;
    const whole = layers.at(1);
    if (layers.length !== 2 || whole === undefined) return false;
    const bits = 8 * whole.bytesPerFrame * (fps ?? USUAL_FPS);
    return whole.gaussians <= (this.budget.gaussians ?? Infinity) && bits <= (this.budget.bitsPerSecond ?? Infinity);
  }

  /**
   * The frame with all layers, where all has come that leads to it; null: the base has to do. `packet`: of the base.
   * Rejects for what is wrong with the connection only.
   */
  async reach(table: FrameTable, frame: number, packet: (frame: number) => Promise<FramePacket>): Promise<Refined | null> {
    const begin = this.begin(table, frame);
    if (begin === null || !this.areHere(table, begin, frame)) return null;
    let step = NOTHING;
    let at = begin;
    try {
      for (; at <= frame; at++) step = await this.decode(table, at, packet);
    } catch (error) {
      if (!(error instanceof StreamError) || error.reason === null) throw error;
      this.union.forget();
      this.damaged = { key: table.keyAt(at) ?? -1, from: at };
      this.notices.push(error);
      return null;
    }
    const gaussians = this.union.gaussians!;
    return { gaussians: { ...gaussians, lastChanged: this.ages.frames }, changedRows: this.changes.take(gaussians.count), step };
  }

  /** Another scene was shown in between: all counts as changed. */
  interrupted(): void {
    this.changes.add(null);
  }

  /** Has the refinements come that lead to a frame, from its keyframe on. */
  async fetch(table: FrameTable, frame: number): Promise<void> {
    const begin = this.begin(table, frame);
    const span = begin === null ? null : this.spanOf(table, begin, frame + 1);
    if (span !== null) await this.source.read(span.offset, span.bytes);
  }

  /** Reads some of the refinements of frames from one on, of its segment; one read at a time, which comes to its end. */
  async readOn(table: FrameTable, from: number): Promise<void> {
    const place = this.reading ? null : this.missing(table, from);
    if (place === null) return;
    this.reading = true;
    try {
      await this.source.read(place.offset, Math.min(place.bytes, READ_AT_ONCE));
    } finally {
      this.reading = false;
    }
  }

  /** Where the refinements of frames from one on lie that have not come; null where all have. */
  private missing(table: FrameTable, from: number): Place | null {
    if (from >= table.length) return null;
    const begin = this.begin(table, from);
    if (begin === null) return null;
    const end = table.segmentEnd(from);
    let missing = begin;
    const { held } = this.source;
    while (missing < end && isRefined(table, held, missing)) missing++;
    return this.spanOf(table, missing, end);
  }

  /** The first frame to decode on the way to one; null where there is no way. */
  private begin(table: FrameTable, frame: number): number | null {
    const key = table.keyAt(frame);
    if (!this.wanted || key === null || (key === this.damaged.key && frame >= this.damaged.from)) return null;
    const { frame: at } = this.union;
    return at !== null && at >= key && at <= frame ? at + 1 : key;
  }

  private areHere(table: FrameTable, begin: number, frame: number): boolean {
    const { held } = this.source;
    for (let at = begin; at <= frame; at++) if (!isRefined(table, held, at)) return false;
    return true;
  }

  /** From the first refinement of these frames up to the end of the last, which follow each other; null for none. */
  private spanOf(table: FrameTable, begin: number, end: number): Place | null {
    let span: Place | null = null;
    for (let at = begin; at < end; at++) {
      const place = table.refinements.get(at);
      if (place === undefined) continue;
      const offset: number = span?.offset ?? place.offset;
      span = { offset, bytes: place.offset + place.bytes - offset };
    }
    return span;
  }

  private async decode(table: FrameTable, frame: number, packet: (frame: number) => Promise<FramePacket>): Promise<UnionStep> {
    const [base, refinement] = [await packet(frame), await this.refinement(table, frame)];
    if (base.kind === "key" && refinement !== null && frame > 0 && !this.union.hasFirst && this.union.refersToFirst(base, refinement)) {
      const first = await this.refinement(table, 0);
      if (first === null) refuse("missing-key", "a keyframe refers to the first one, whose refinement is missing");
      this.union.keepFirst((await packet(0)).payload, first);
    }
    const step = this.union.apply(base, refinement);
    this.changes.add(step.slots);
    this.ages.note(frame, base.kind === "key" ? null : step.slots, this.union.gaussians!.count);
    return step;
  }

  private async refinement(table: FrameTable, frame: number): Promise<Refinement | null> {
    const place = table.refinements.get(frame);
    if (place === undefined) return null;
    const data = await this.source.read(place.offset, place.bytes);
    try {
      if (data.length < PACKET_HEADER_BYTES) refuse("truncated", "the stream stops inside a packet header");
      const header = readPacketHeader(data.subarray(0, PACKET_HEADER_BYTES), this.limits.payloadBytes);
      if (header.kind !== KIND.REFINE || header.frame !== frame) refuse("index-mismatch", `the refinement of frame ${frame} lies elsewhere`);
      return readRefinement(readPayload(data, header.length));
    } catch (error) {
      throw isDamage(error) ? error.at(null, place.offset) : error;
    }
  }
}
