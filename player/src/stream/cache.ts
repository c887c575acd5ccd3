/** A source whose bytes come in blocks and stay for a while, so that memory is bounded however long a stream is. */

import { joined } from "./bytes";
import type { Access, ByteSource, Span } from "./sources";

/** Where blocks come from: a server or a file. */
export interface Feed {
  readonly name: string;
  readonly access: Access;
  readonly size: number | null;
  /** What is wrong with the connection while it is tried again; null when nothing is. */
  readonly trouble?: string | null;
  /** Called when `trouble` is another one. */
  onTrouble?: () => void;
  /** Bytes from an offset on, in the pieces that come; fewer where the source ends. */
  load(offset: number, length: number, signal: AbortSignal, take: (piece: Uint8Array) => void): Promise<void>;
  refresh(): Promise<boolean>;
  close(): void;
}

export interface CacheSizes {
  readonly block: number;
  /** What all blocks together may take. */
  readonly kept: number;
  /** The first read: header and, with luck, first keyframe in one go. */
  readonly opening: number;
  /** What one request asks for when reading ahead begins; each one after it asks for twice as much. */
  readonly firstRequest: number;
  /** The most that one request asks for, when it reads ahead. */
  readonly request: number;
}

export const CACHE_SIZES: CacheSizes = { block: 1 << 16, kept: 48 << 20, opening: 1 << 18, firstRequest: 1 << 17, request: 1 << 20 };

/** Reading ahead, from `next` on, which grows, up to `end`. */
interface Ahead {
  readonly controller: AbortController;
  next: number;
  end: number;
  done: Promise<void>;
}

/** Blocks on their way, which several may wait for; given up when none waits any more. */
class Loading {
  readonly controller = new AbortController();
  /** Then there is nothing left to give up, and what the controller is good for may have other uses. */
  settled = false;
  failure: unknown = null;
  /** The block that comes next. */
  next: number;
  /** Whether it goes on although nobody waits. */
  kept = false;
  private waiting = 0;
  private wakers: (() => void)[] = [];

  constructor(first: number) {
    this.next = first;
  }

  /** A block has come, or nothing more will. */
  progress(): void {
    for (const wake of this.wakers.splice(0)) wake();
  }

  /** Waits until a block has come, or for the signal. */
  async until(number: number, signal?: AbortSignal): Promise<void> {
    this.waiting++;
    const leave = (): void => {
      this.progress();
    };
    signal?.addEventListener("abort", leave);
    try {
      while (this.next <= number && !this.settled) {
        signal?.throwIfAborted();
        await new Promise<void>((wake) => this.wakers.push(wake));
      }
      signal?.throwIfAborted();
      if (this.next <= number && this.failure !== null) throw this.failure as Error;
    } finally {
      signal?.removeEventListener("abort", leave);
      if (--this.waiting === 0 && !this.settled && !this.kept) this.controller.abort();
    }
  }
}

export class CachedSource implements ByteSource {
  bytesRead = 0;
  onChange: (() => void) | null = null;
  /** By number; the one used last is the last. */
  private readonly blocks = new Map<number, Uint8Array>();
  private readonly loading = new Map<number, Loading>();
  private kept = 0;
  private ahead: Ahead | null = null;
  private nextRequest: number;

  constructor(
    private readonly feed: Feed,
    private readonly sizes: CacheSizes = CACHE_SIZES,
  ) {
    this.nextRequest = sizes.firstRequest;
    feed.onTrouble = () => this.onChange?.();
  }

  get name(): string {
    return this.feed.name;
  }

  get access(): Access {
    return this.feed.access;
  }

  get size(): number | null {
    return this.feed.size;
  }

  get trouble(): string | null {
    return this.feed.trouble ?? null;
  }

  /** Bytes of blocks in memory. */
  get bytesKept(): number {
    return this.kept;
  }

  get held(): readonly Span[] {
    const spans: [number, number][] = [];
    for (const number of [...this.blocks.keys()].sort((a, b) => a - b)) {
      const start = number * this.sizes.block;
      const end = start + this.blocks.get(number)!.length;
      const last = spans.at(-1);
      if (last?.[1] === start) last[1] = end;
      else spans.push([start, end]);
    }
    return spans;
  }

  async read(offset: number, length: number, signal?: AbortSignal): Promise<Uint8Array> {
    const opening = this.bytesRead === 0 && this.loading.size === 0 ? Math.max(length, this.sizes.opening) : length;
    const blocks = await this.blocksOf(offset, length, opening, signal);
    const start = offset % this.sizes.block;
    if (blocks.length === 1) return blocks[0].subarray(start, start + length);
    return joined(blocks).subarray(start, start + length);
  }

  /** What is read ahead already goes on, further; anything else is given up. */
  async prefetch(offset: number, length: number): Promise<void> {
    const { block, firstRequest } = this.sizes;
    const start = offset - (offset % block);
    if (this.ahead !== null && this.leadsTo(start, this.ahead.next)) {
      this.ahead.end = Math.max(this.ahead.end, offset + length);
      return this.ahead.done;
    }
    this.ahead?.controller.abort();
    if (!this.isComing(start / block)) this.nextRequest = firstRequest;
    const ahead: Ahead = { controller: new AbortController(), next: start, end: offset + length, done: Promise.resolve() };
    this.ahead = ahead;
    ahead.done = this.readAhead(ahead);
    return ahead.done;
  }

  /** Whether all blocks from one place to another are there or on their way. */
  private leadsTo(start: number, end: number): boolean {
    const { block } = this.sizes;
    if (start > end) return false;
    for (let at = start; at < this.endWithin(end); at += block) if (!this.isComing(at / block)) return false;
    return true;
  }

  private isComing(number: number): boolean {
    return this.isHeld(number) || this.loading.has(number);
  }

  /**
   * One request after the other, so that what is due first has the link for itself; the next one is sent while the last
   * quarter of the one before comes.
   */
  private async readAhead(ahead: Ahead): Promise<void> {
    const { block, request } = this.sizes;
    const { signal } = ahead.controller;
    let before = Promise.resolve();
    try {
      while (ahead.next < this.endWithin(ahead.end)) {
        const start = ahead.next;
        if (this.isComing(start / block)) {
          ahead.next += block;
          await this.loading.get(start / block)?.until(start / block, signal);
          continue;
        }
        const asked = Math.min(this.nextRequest, this.endWithin(ahead.end) - start);
        ahead.next += Math.ceil(asked / block) * block;
        const coming = this.missing(start, asked, asked, signal);
        coming.catch(() => undefined); // it is awaited below, or nobody cares any more
        await before;
        before = coming;
        const most = asked - Math.floor(asked / 4 / block) * block;
        await this.missing(start, most, most, signal);
        this.nextRequest = Math.min(request, 2 * this.nextRequest);
      }
      await before;
    } catch (error) {
      if (!signal.aborted) throw error;
    } finally {
      if (this.ahead === ahead) this.ahead = null;
    }
  }

  refresh(): Promise<boolean> {
    return this.feed.refresh();
  }

  close(): void {
    this.onChange = null;
    this.ahead?.controller.abort();
    for (const { controller } of this.loading.values()) controller.abort();
    this.feed.close();
    this.blocks.clear();
    this.kept = 0;
  }

  private endWithin(end: number): number {
    return this.size === null ? end : Math.min(end, this.size);
  }

  /** The blocks that hold a range, in order; fewer where the source ends. */
  private async blocksOf(offset: number, length: number, wanted: number, signal?: AbortSignal): Promise<Uint8Array[]> {
    const held = this.heldBlocks(offset, length);
    if (held !== null) return held;
    if (length <= this.sizes.kept / 2) {
      await this.missing(offset, length, wanted, signal);
      const read = this.heldBlocks(offset, length);
      if (read !== null) return read;
    }
    // More than is kept: it goes on to whoever asked, past the cache.
    const start = offset - (offset % this.sizes.block);
    const parts: Uint8Array[] = [];
    const end = this.endWithin(offset + length);
    await this.load(start, end - start, signal ?? new AbortController().signal, (piece) => parts.push(piece));
    return [joined(parts)];
  }

  /** null when one is not there. */
  private heldBlocks(offset: number, length: number): Uint8Array[] | null {
    const { block } = this.sizes;
    const end = this.endWithin(offset + length);
    const blocks: Uint8Array[] = [];
    for (let start = offset - (offset % block); start < end; start += block) {
      const bytes = this.blocks.get(start / block);
      if (bytes === undefined || !this.isHeld(start / block)) return null;
      this.touch(start / block, bytes);
      blocks.push(bytes);
      if (bytes.length < block) break;
    }
    return blocks.length > 0 ? blocks : [new Uint8Array(0)];
  }

  private touch(number: number, bytes: Uint8Array): void {
    this.blocks.delete(number);
    this.blocks.set(number, bytes);
  }

  /** Asks for the blocks of a range, `wanted` of it, that are not there, and waits for those of `length`. */
  private async missing(offset: number, length: number, wanted: number, signal?: AbortSignal): Promise<void> {
    const { block } = this.sizes;
    const first = Math.floor(offset / block);
    const lastOf = (bytes: number): number => Math.floor((Math.max(offset + 1, this.endWithin(offset + bytes)) - 1) / block);
    const [last, lastAsked] = [lastOf(length), lastOf(wanted)];
    const waited = new Map<Loading, number>();
    for (let number = first; number <= lastAsked; number++) {
      if (this.isHeld(number)) continue;
      const loading = this.loading.get(number) ?? this.start(number, lastAsked);
      if (number <= last) waited.set(loading, number);
      else loading.kept = true;
    }
    await Promise.all([...waited].map(([loading, number]) => loading.until(number, signal)));
  }

  /** Whether a block is there, as far as the source has it: a short one is the last, until the source grows. */
  private isHeld(number: number): boolean {
    const { block } = this.sizes;
    const bytes = this.blocks.get(number);
    if (bytes === undefined) return false;
    return bytes.length === block || this.size === null || number * block + bytes.length >= this.size;
  }

  /** Asks for blocks from one on, up to the next that is there or on its way; each is kept as it comes. */
  private start(first: number, last: number): Loading {
    const { block } = this.sizes;
    let end = first;
    while (end <= last && !this.isHeld(end) && !this.loading.has(end)) end++;
    const loading = new Loading(first);
    for (let number = first; number < end; number++) this.loading.set(number, loading);
    const forget = (number: number): void => {
      if (this.loading.get(number) === loading) this.loading.delete(number);
    };
    const forgetRest = (): void => {
      for (let number = loading.next; number < end; number++) forget(number);
    };
    loading.controller.signal.addEventListener("abort", forgetRest); // whoever comes now asks anew
    const came = (bytes: Uint8Array): void => {
      this.keep(loading.next, bytes);
      forget(loading.next++);
      loading.settled = loading.next === end; // nothing is left to give up, and the connection serves the next request
      loading.progress();
      this.onChange?.();
    };
    const filling = new Filling(block, came);
    const done = (failure: unknown): void => {
      loading.failure = failure;
      loading.settled = true;
      forgetRest();
      loading.progress();
    };
    const asked = this.endWithin(end * block) - first * block;
    this.load(first * block, asked, loading.controller.signal, filling.take).then(() => {
      // The source ends here: what is missing of the last block, and blocks behind it, are empty.
      for (let rest = filling.rest(); loading.next < end; rest = new Uint8Array(0)) came(rest);
      done(null);
    }, done);
    return loading;
  }

  private async load(offset: number, length: number, signal: AbortSignal, take: (piece: Uint8Array) => void): Promise<void> {
    await this.feed.load(offset, length, signal, (piece) => {
      this.bytesRead += piece.length;
      take(piece);
    });
  }

  private keep(number: number, bytes: Uint8Array): void {
    this.kept += bytes.length - (this.blocks.get(number)?.length ?? 0);
    this.touch(number, bytes);
    for (const [oldest, old] of this.blocks) {
      if (this.kept <= this.sizes.kept) break;
      this.blocks.delete(oldest);
      this.kept -= old.length;
    }
  }
}

/** Makes blocks of pieces. */
class Filling {
  private parts: Uint8Array[] = [];
  private missing: number;

  constructor(
    private readonly block: number,
    private readonly full: (bytes: Uint8Array) => void,
  ) {
    this.missing = block;
  }

  readonly take = (piece: Uint8Array): void => {
    for (let rest = piece; rest.length > 0; ) {
      const part = rest.subarray(0, this.missing);
      this.parts.push(part);
      rest = rest.subarray(part.length);
      this.missing -= part.length;
      if (this.missing === 0) this.full(this.rest());
    }
  };

  /** What of a block has come. */
  rest(): Uint8Array {
    const bytes = joined(this.parts);
    this.parts = [];
    this.missing = this.block;
    return bytes;
  }
}
