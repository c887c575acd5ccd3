/** An open stream: any frame's scene, in any order, from bytes as they are needed. */

import { StreamError, isDamage, type Reason } from "../container/errors";
import { DEFAULT_LIMITS, type Limits } from "../container/limits";
import { startZstd } from "../entropy/zstd";
import type { Budget } from "../messages";
import type { FrameEntry, FrameMetrics, SceneFrame, SceneStream, SoundFrame, Still, StreamHeader } from "../scene";
import { Decoder, type FramePacket, type Step } from "../state/decoder";
import { BlobFeed } from "./blob";
import { CachedSource } from "./cache";
import { Ages } from "./ages";
import { Changes } from "./changes";
import { leadsTo, readFramePacket } from "./framePackets";
import { FrameTable } from "./frameTable";
import { HttpFeed } from "./http";
import { Layers, USUAL_FPS, type Refined } from "./layers";
import { heldFrames, heldShare, holds, refinedFrames } from "./heldFrames";
import { Metrics } from "./metrics";
import { readIndexAtEnd, readOpening, type Opening } from "./opening";
import { Pauses } from "./pauses";
import { readSound } from "./sound";
import { MemorySource, type ByteSource, type Span } from "./sources";
import { Walk } from "./walk";

export interface StreamOptions {
  /** Whether the source may still grow: then an end inside a packet is no damage. */
  readonly follow?: boolean;
  /** Limits on what is decoded; those of SPEC section 8 when left out. */
  readonly limits?: Partial<Limits>;
  readonly signal?: AbortSignal;
  /** Whether what follows a frame is read while it is decoded, without `prefetch`. */
  readonly ahead?: boolean;
  /** Whether another server gets the cookies that it has set: "include"; those of the page's own come without. */
  readonly credentials?: RequestCredentials;
  /** Called when more bytes have come, the index was read, or the connection is gone or back. */
  readonly onChange?: () => void;
}

/** How many bytes ahead `prefetch` reads. */
const AHEAD_BYTES = 8 << 20;
/** Of the base: what is read before something else, and below what nothing else is read. */
const BASE_SECONDS = 3;
const BASE_SECONDS_AT_LEAST = 1;
/** Frames. */
const WALKED_AT_ONCE = 16;
/** What is found where an index that is wrong says that a frame lies. */
const WRONG_INDEX: ReadonlySet<Reason | null> = new Set<Reason | null>([
  "index-mismatch",
  "bad-sync",
  "bad-header-crc",
  "truncated",
  "misplaced-packet",
]);
const NOTHING: Omit<Step, "corrections"> = { slots: new Uint32Array(0), changed: 0, added: 0, removed: 0 };

/** An address, a file that was chosen or dropped, bytes, or a source of one's own. */
export type StreamSource = string | URL | Blob | ArrayBuffer | Uint8Array | ByteSource;

/**
 * Opens a stream: reads its header packet and the first frame's packet header, and begins to look for the index.
 * Rejects with a StreamError.
 */
export async function createStream(source: StreamSource, options: StreamOptions = {}): Promise<SceneStream> {
  const bytes = sourceOf(source, options);
  bytes.onChange = options.onChange ?? null;
  const limits = { ...DEFAULT_LIMITS, ...options.limits };
  try {
    // Compiled while the header comes; whoever decodes waits for it.
    startZstd().catch(() => undefined);
    const opening = await readOpening(bytes, limits, options.signal);
    const stream = new OpenStream(bytes, opening, limits, options);
    await stream.findFirst(options.signal);
    return stream;
  } catch (error) {
    bytes.close();
    throw error;
  }
}

function sourceOf(source: StreamSource, { follow = false, credentials }: StreamOptions): ByteSource {
  if (typeof source === "string" || source instanceof URL) return new CachedSource(new HttpFeed(String(source), follow, undefined, credentials));
  if (source instanceof Blob) return new CachedSource(new BlobFeed(source));
  if (source instanceof ArrayBuffer || source instanceof Uint8Array) return new MemorySource(source);
  return source;
}

/** The frame that was shown last, and what its packet did. */
interface Shown {
  readonly frame: number;
  readonly step: Step;
}

class OpenStream implements SceneStream {
  readonly header: StreamHeader;
  private readonly follow: boolean;
  private readonly ahead: boolean;
  /** The frame that was asked for last. */
  private target = -1;
  private readonly decoder: Decoder;
  /** For keyframes that are looked at while another frame is shown. */
  private aside: Decoder | null = null;
  private readonly changes = new Changes();
  private readonly ages = new Ages();
  private readonly walked = new FrameTable();
  private readonly walk: Walk;
  private walking: Promise<unknown> = Promise.resolve();
  /** The frames by the index, once that is read; null when there is none that can be used. */
  private indexed: FrameTable | null = null;
  private readonly indexRead: Promise<void>;
  private readonly indexNotices: StreamError[] = [];
  private shown: Shown | null = null;
  /** Why the frame before is shown, from a damaged frame on up to the next keyframe. */
  private held: StreamError | null = null;
  private turn: Promise<unknown> = Promise.resolve();
  private readonly pauses = new Pauses();
  private closed = false;
  private readonly figures = new Metrics();
  /** Reading ahead that began last; what began before gives way. */
  private aheadTurn = 0;
  private readonly layers: Layers;
  /** The layer that was given last. */
  private layer = 0;

  constructor(
    private readonly source: ByteSource,
    private readonly opening: Opening,
    private readonly limits: Limits,
    { follow = false, ahead = false, onChange }: StreamOptions,
  ) {
    this.layers = new Layers(source, opening.header, limits);
    this.follow = follow;
    this.ahead = ahead;
    this.header = opening.header;
    this.decoder = new Decoder(opening.header, limits);
    this.walk = new Walk(source, this.walked, opening.end, limits, follow, this.figures.note);
    this.indexRead = this.readIndex();
    // Whoever needs the index awaits it.
    this.indexRead.then(onChange, () => undefined);
  }

  get metrics(): ReadonlyMap<number, FrameMetrics> {
    return this.figures.byFrame;
  }

  get frames(): readonly FrameEntry[] {
    return this.table.entries;
  }

  get complete(): boolean {
    return this.indexed !== null || this.walk.ended;
  }

  get waits(): boolean {
    return this.indexed === null && this.walk.waits;
  }

  get bytesRead(): number {
    return this.source.bytesRead;
  }

  get trouble(): string | null {
    return this.source.trouble ?? null;
  }

  get buffered(): readonly Span[] {
    return heldFrames(this.table, this.source.held);
  }

  get refined(): readonly Span[] {
    return refinedFrames(this.table, this.source.held);
  }

  share(frame: number): number {
    return heldShare(this.table, this.source.held, frame);
  }

  get notices(): readonly string[] {
    const errors = [...(this.indexed === null ? [...this.indexNotices, ...this.walk.notices] : this.indexNotices), ...this.layers.notices];
    const notices = errors.map((error) => `${error.sentence}.`);
    if (this.indexed === null && this.walk.stopsInside && !this.follow) {
      notices.push("the stream stops inside a packet (truncated): it is cut off, or not finished yet.");
    }
    return notices;
  }

  /** Reads the first frame's packet header, which mostly came along with the header packet. */
  async findFirst(signal?: AbortSignal): Promise<void> {
    await this.walkTo(1, signal);
  }

  frame(index: number, signal?: AbortSignal): Promise<SceneFrame> {
    return this.inTurn(() => this.show(index, signal));
  }

  async keyframe(index: number): Promise<Still> {
    this.checkOpen();
    await startZstd();
    const key = (await this.isIndexed(index)) ? this.table.keyAt(index) : null;
    if (key === null) throw new StreamError("missing-key", `frame ${index} needs a keyframe before it`);
    const { payload, ...packet } = await this.packet(key);
    const aside = (this.aside ??= new Decoder(this.header, this.limits));
    if (aside.refersToFirst(payload) && !aside.hasFirst) aside.keepFirst((await this.packet(0)).payload);
    aside.apply({ ...packet, payload }, true);
    return { frame: key, gaussians: aside.gaussians };
  }

  async prefetch(from: number): Promise<void> {
    await this.indexRead;
    if (!(await this.isIndexed(from))) return;
    const start = this.table.offset(from);
    if (start < 0) return;
    const turn = ++this.aheadTurn;
    // What is due first comes first: some of the base, then what refines it.
    const length = this.hasLayers ? Math.min(AHEAD_BYTES, this.baseEnd(from, BASE_SECONDS) - start) : AHEAD_BYTES;
    if (!(this.hasLayers && this.hasBase(from))) {
      await Promise.all([this.source.prefetch(start, length), this.walkAhead(start + length, turn)]);
    }
    if (this.hasLayers && this.hasBase(from)) await this.layers.readOn(this.table, from);
    // Where there is an index, nobody walks along the packets.
    if (this.indexed !== null) {
      const goesOn = (): boolean => !this.closed && turn === this.aheadTurn; // what was read ahead may be given up
      await this.figures.find(this.source, this.indexed, Math.max(0, from - 1), start + AHEAD_BYTES, this.limits, goesOn);
    }
  }

  /** Where there is no index, frames are found as their bytes come; a few at a time, since others wait for the walk, too. */
  private async walkAhead(end: number, turn: number): Promise<void> {
    for (let count = -1; this.indexed === null && count !== this.table.length && turn === this.aheadTurn; ) {
      count = this.table.length;
      await this.walkTo(count + WALKED_AT_ONCE, undefined, end);
    }
  }

  /** Whether all layers are wanted and can be had: only an index tells where those above the base lie. */
  private get hasLayers(): boolean {
    return this.indexed !== null && this.layers.wanted;
  }

  /** Whether enough of the base is there to read something else. */
  private hasBase(from: number): boolean {
    const start = this.table.offset(from);
    return start < 0 || holds(this.source.held, start, this.baseEnd(from, BASE_SECONDS_AT_LEAST) - start);
  }

  /** Where the base's packets end, so many seconds on, or with a frame's segment. */
  private baseEnd(frame: number, seconds: number): number {
    const later = frame + Math.ceil(seconds * (this.header.fps ?? USUAL_FPS));
    const last = this.table.segmentEnd(frame, later + 1) - 1;
    const offset = this.table.offset(last);
    return offset < 0 ? Infinity : offset + this.table.entries[last].bytes;
  }

  keepWithin(budget: Budget): void {
    this.layers.budget = budget;
  }

  async refine(frame: number): Promise<boolean> {
    await this.indexRead;
    if (this.closed || !this.hasLayers || frame >= this.table.length) return false;
    if (this.ahead && !this.hasBase(frame)) return false;
    await this.layers.fetch(this.table, frame);
    return !this.closed;
  }

  async sound(from: number, to: number): Promise<SoundFrame[]> {
    const { table } = this;
    const frames: SoundFrame[] = [];
    for (let frame = from; frame < Math.min(to, table.length) && !this.closed; frame++) {
      if (table.offset(frame) < 0) continue; // lost
      frames.push(await readSound(this.source, table, frame, this.header.sound.length, this.limits));
    }
    return frames;
  }

  refresh(): Promise<boolean> {
    return this.inTurn(async () => {
      this.checkOpen();
      if (this.complete || !(await this.source.refresh())) return false;
      await this.walkTo(Infinity);
      return true;
    });
  }

  close(): void {
    this.closed = true;
    this.source.close();
  }

  private get table(): FrameTable {
    return this.indexed ?? this.walked;
  }

  /** One after the other: there is one state. */
  private inTurn<T>(work: () => Promise<T>): Promise<T> {
    const turn = this.turn.then(work);
    this.turn = turn.catch(() => undefined);
    return turn;
  }

  private async readIndex(): Promise<void> {
    // Where the whole file lies before its end, going there would read it.
    if (this.source.access !== "sequential") {
      this.indexed = await readIndexAtEnd(this.source, this.opening, this.limits);
    }
    if (this.indexed === null && this.source.access === "local") await this.walkTo(Infinity);
  }

  /** Finds frames without the index, up to so many or up to an offset; the walk is one, whoever needs it. */
  private async walkTo(frames: number, signal?: AbortSignal, offset = Infinity): Promise<void> {
    const walking = this.walking.then(async () => {
      if (this.indexed === null) await this.walk.until(frames, offset, signal);
    });
    this.walking = walking.catch(() => undefined);
    await walking;
  }

  private async isIndexed(frame: number, signal?: AbortSignal): Promise<boolean> {
    if (frame >= this.table.length) await this.indexRead;
    if (frame >= this.table.length) await this.walkTo(frame + 1, signal);
    return frame < this.table.length;
  }

  private async show(index: number, signal?: AbortSignal): Promise<SceneFrame> {
    this.checkOpen();
    signal?.throwIfAborted();
    await startZstd();
    if (!(Number.isInteger(index) && index >= 0 && (await this.isIndexed(index, signal)))) {
      throw new StreamError(null, `frame ${index} is not in this stream of ${this.table.length} frames`);
    }
    this.pauses.begin();
    this.target = index;
    let shown = this.canStepTo(index) ? this.shown! : await this.jump(index, signal);
    while (shown.frame < index) shown = await this.stepOn(shown, signal);
    const refined = this.held === null && this.layers.wanted ? await this.reachRefined(index, signal) : null;
    return this.sceneFrame(shown, refined);
  }

  /** With all layers, where they have come. */
  private reachRefined(index: number, signal?: AbortSignal): Promise<Refined | null> {
    return this.layers.reach(this.table, index, (frame) => this.packet(frame, signal));
  }

  /** Whether to go on from the frame that is shown; else a keyframe lies between, or the frame lies before. */
  private canStepTo(index: number): boolean {
    if (this.shown === null || index < this.shown.frame) return false;
    return (this.table.keyAt(index) ?? 0) <= this.shown.frame + 1;
  }

  /** To the last keyframe up to a frame that can be reconstructed. */
  private async jump(index: number, signal?: AbortSignal): Promise<Shown> {
    let failure: StreamError | null = null;
    this.readTo(index);
    for (let key = this.table.keyAt(index); key !== null; key = this.table.keyAt(key - 1)) {
      try {
        return await this.decode(key, true, signal);
      } catch (error) {
        if (!isDamage(error)) throw error;
        failure ??= error;
      }
    }
    throw failure ?? this.noKeyBefore(index);
  }

  /** Has all come that leads to a frame, and gives up what was on its way for others. */
  private readTo(index: number): void {
    const [key, { table }] = [this.table.keyAt(index), this];
    if (key === null || table.offset(index) < 0) return;
    const end = table.offset(index) + table.entries[index].bytes;
    // Whoever decodes says what goes wrong.
    this.source.prefetch(table.offset(key), end - table.offset(key)).catch(() => undefined);
  }

  private readBehind(frame: number): void {
    const { table } = this;
    const end = table.offset(frame) + table.entries[frame].bytes;
    if (this.hasLayers && this.hasBase(frame)) return;
    const length = this.hasLayers ? this.baseEnd(frame, BASE_SECONDS) - end : AHEAD_BYTES;
    this.source.prefetch(end, Math.min(AHEAD_BYTES, length)).catch(() => undefined); // whoever needs the bytes says what goes wrong
  }

  private noKeyBefore(index: number): StreamError {
    const lost = this.table.entries[index].kind === null;
    return lost ? this.table.cause(index) : new StreamError("missing-key", `frame ${index} needs a keyframe before it`);
  }

  /** To the next frame; one that is damaged, and those after it up to a keyframe, show the last good one. */
  private async stepOn(before: Shown, signal?: AbortSignal): Promise<Shown> {
    const frame = before.frame + 1;
    const { kind } = this.table.entries[frame];
    if (this.held === null || kind === "key") {
      try {
        if (kind === null) throw this.table.cause(frame);
        return await this.decode(frame, this.held !== null, signal);
      } catch (error) {
        if (!isDamage(error)) throw error;
        this.held = error;
      }
    }
    this.shown = { frame, step: { ...NOTHING, corrections: before.step.corrections } };
    return this.shown;
  }

  private async decode(frame: number, jump: boolean, signal?: AbortSignal): Promise<Shown> {
    await this.pauses.take();
    const packet = await this.packet(frame, signal);
    if (this.ahead && frame === this.target) this.readBehind(frame);
    try {
      if (packet.kind === "key" && this.decoder.refersToFirst(packet.payload)) await this.needFirst(signal);
      const step = this.decoder.apply(packet, jump);
      this.changes.add(step.slots);
      this.ages.note(frame, packet.kind === "key" ? null : step.slots, this.decoder.gaussians.count);
      this.held = null;
      this.shown = { frame, step };
      return this.shown;
    } catch (error) {
      throw error instanceof StreamError ? error.at(null, this.table.offset(frame)) : error;
    }
  }

  private async needFirst(signal?: AbortSignal): Promise<void> {
    if (this.decoder.hasFirst || this.table.entries[0].kind !== "key") return;
    const { payload } = await this.packet(0, signal);
    this.decoder.keepFirst(payload);
  }

  /** A frame's packet; an index that leads astray is given up. */
  private async packet(frame: number, signal?: AbortSignal): Promise<FramePacket> {
    const { table } = this;
    try {
      return await readFramePacket(this.source, table, frame, this.limits, this.figures.note, signal);
    } catch (error) {
      if (!isDamage(error) || table !== this.indexed || !WRONG_INDEX.has(error.reason)) throw error;
      if (await leadsTo(this.source, table, frame, this.opening.end, this.limits, signal)) throw error;
      this.indexed = null;
      this.indexNotices.push(error);
      if (!(await this.isIndexed(frame, signal)) || this.table.entries[frame].kind === null) throw error;
      return readFramePacket(this.source, this.table, frame, this.limits, this.figures.note, signal);
    }
  }

  private sceneFrame({ frame, step }: Shown, refined: Refined | null): SceneFrame {
    const { kind, bytes } = this.table.entries[frame];
    const gaussians = refined?.gaussians ?? { ...this.decoder.gaussians, lastChanged: this.ages.frames };
    const { corrections } = step;
    const { changed, added, removed } = refined?.step ?? step;
    const layer = refined === null ? 0 : 1;
    const damage =
      this.held === null ? null : `frame ${frame} shows frame ${this.decoder.frame ?? 0}: ${this.held.sentence}`;
    const own = this.changes.take(this.decoder.gaussians.count);
    const changedRows = layer === this.layer ? (refined === null ? own : refined.changedRows) : null;
    if (refined === null) this.layers.interrupted();
    this.layer = layer;
    const shownKind = this.held === null ? kind : null;
    return { frame, kind: shownKind, bytes, layer, damage, gaussians, changedRows, changed, added, removed, corrections };
  }

  private checkOpen(): void {
    if (this.closed) throw new StreamError(null, "the stream is closed");
  }
}
