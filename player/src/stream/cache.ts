/** A source whose bytes come in blocks and stay for a while, so that memory is bounded however long a stream is. */

import { joined } from "./bytes";
import type { Access, ByteSource } from "./sources";

/** Where blocks come from: a server or a file. */
export interface Feed {
  readonly name: string;
  readonly access: Access;
  readonly size: number | null;
  /** Bytes from an offset on; fewer where the source ends. */
  load(offset: number, length: number, signal: AbortSignal): Promise<Uint8Array>;
  refresh(): Promise<boolean>;
  close(): void;
}

export interface CacheSizes {
  readonly block: number;
  /** What all blocks together may take. */
  readonly kept: number;
  /** The first read: header and, with luck, first keyframe in one go. */
  readonly opening: number;
  /** What one request asks for at most, when it reads ahead. */
  readonly request: number;
}

export const CACHE_SIZES: CacheSizes = { block: 1 << 16, kept: 48 << 20, opening: 1 << 18, request: 1 << 20 };
/** Requests at a time that read ahead: while one's answer comes, the next is on its way. */
const REQUESTS_AHEAD = 2;

/** Blocks on their way, which several may wait for; given up when none waits any more. */
interface Loading {
  readonly done: Promise<void>;
  readonly controller: AbortController;
  waiting: number;
  /** Then there is nothing left to give up, and what the controller is good for may have other uses. */
  settled: boolean;
}

export class CachedSource implements ByteSource {
  bytesRead = 0;
  /** By number; the one used last is the last. */
  private readonly blocks = new Map<number, Uint8Array>();
  private readonly loading = new Map<number, Loading>();
  private kept = 0;
  private ahead = new AbortController();

  constructor(
    private readonly feed: Feed,
    private readonly sizes: CacheSizes = CACHE_SIZES,
  ) {}

  get name(): string {
    return this.feed.name;
  }

  get access(): Access {
    return this.feed.access;
  }

  get size(): number | null {
    return this.feed.size;
  }

  /** Bytes of blocks in memory. */
  get bytesKept(): number {
    return this.kept;
  }

  async read(offset: number, length: number, signal?: AbortSignal): Promise<Uint8Array> {
    const opening = this.bytesRead === 0 && this.loading.size === 0 ? Math.max(length, this.sizes.opening) : length;
    const blocks = await this.blocksOf(offset, length, opening, signal);
    const start = offset % this.sizes.block;
    if (blocks.length === 1) return blocks[0].subarray(start, start + length);
    return joined(blocks).subarray(start, start + length);
  }

  async prefetch(offset: number, length: number): Promise<void> {
    this.ahead.abort();
    this.ahead = new AbortController();
    const { signal } = this.ahead;
    const { block, request } = this.sizes;
    const end = this.endWithin(offset + length);
    let next = offset - (offset % block);
    // Up to what is on its way at once, so that it is not given up for want of somebody who waits.
    while (next < end && this.isHeld(next / block)) next += block;
    const readOn = async (): Promise<void> => {
      while (next < end && !signal.aborted) {
        const start = next;
        next += request;
        await this.missing(start, Math.min(request, end - start), signal);
      }
    };
    try {
      await Promise.all(Array.from({ length: REQUESTS_AHEAD }, readOn));
    } catch (error) {
      if (!signal.aborted) throw error;
    }
  }

  refresh(): Promise<boolean> {
    return this.feed.refresh();
  }

  close(): void {
    this.ahead.abort();
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
    const held = this.held(offset, length);
    if (held !== null) return held;
    if (length <= this.sizes.kept / 2) {
      await this.missing(offset, wanted, signal);
      const found = this.held(offset, length);
      if (found !== null) return found;
    }
    // More than is kept: it goes on to whoever asked, past the cache.
    const start = offset - (offset % this.sizes.block);
    return [await this.load(start, offset + length - start, signal ?? new AbortController().signal)];
  }

  /** null when one is not there. */
  private held(offset: number, length: number): Uint8Array[] | null {
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

  /** Waits until blocks of a range have come that are not there. */
  private async missing(offset: number, length: number, signal?: AbortSignal): Promise<void> {
    const { block } = this.sizes;
    const first = Math.floor(offset / block);
    const last = Math.floor((Math.max(offset + 1, this.endWithin(offset + length)) - 1) / block);
    const waited = new Set<Loading>();
    for (let number = first; number <= last; number++) {
      if (this.isHeld(number)) continue;
      const loading = this.loading.get(number) ?? this.start(number, last);
      waited.add(loading);
    }
    await Promise.all([...waited].map((loading) => waitFor(loading, signal)));
  }

  /** Whether a block is there, as far as the source has it: a short one is the last, until the source grows. */
  private isHeld(number: number): boolean {
    const { block } = this.sizes;
    const bytes = this.blocks.get(number);
    if (bytes === undefined) return false;
    return bytes.length === block || this.size === null || number * block + bytes.length >= this.size;
  }

  /** Asks for blocks from one on, up to the next that is there or on its way. */
  private start(first: number, last: number): Loading {
    const { block } = this.sizes;
    let end = first;
    while (end <= last && !this.isHeld(end) && !this.loading.has(end)) end++;
    const controller = new AbortController();
    const done = this.load(first * block, (end - first) * block, controller.signal).then((bytes) => {
      for (let number = first; number < end; number++) {
        const start = (number - first) * block;
        this.keep(number, bytes.slice(start, start + block));
      }
    });
    const loading: Loading = { done, controller, waiting: 0, settled: false };
    for (let number = first; number < end; number++) this.loading.set(number, loading);
    const forget = (): void => {
      loading.settled = true;
      for (let number = first; number < end; number++) {
        if (this.loading.get(number) === loading) this.loading.delete(number);
      }
    };
    done.then(forget, forget);
    return loading;
  }

  private async load(offset: number, length: number, signal: AbortSignal): Promise<Uint8Array> {
    const bytes = await this.feed.load(offset, this.endWithin(offset + length) - offset, signal);
    this.bytesRead += bytes.length;
    return bytes;
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

/** Waits for blocks, or for the signal; blocks that nobody waits for any more are given up. */
async function waitFor(loading: Loading, signal?: AbortSignal): Promise<void> {
  loading.waiting++;
  let leave: (() => void) | undefined;
  const left = new Promise<never>((_, reject) => {
    leave = (): void => {
      reject(signal!.reason as Error);
    };
    if (signal?.aborted) leave();
    else signal?.addEventListener("abort", leave);
  });
  try {
    await Promise.race([loading.done, left]);
  } finally {
    if (leave) signal?.removeEventListener("abort", leave);
    if (--loading.waiting === 0 && !loading.settled) loading.controller.abort();
  }
}
