/** Where a stream's bytes come from. */

/**
 * What reading costs: nothing worth saving ("local"), what is read ("ranges"), or all that lies before as well
 * ("sequential").
 */
export type Access = "local" | "ranges" | "sequential";

/** From one place up to, not including, another. */
export type Span = readonly [from: number, to: number];

/** Bytes by their offset. Methods reject with a StreamError where bytes cannot be had, and with the signal's reason. */
export interface ByteSource {
  /** For messages. */
  readonly name: string;
  readonly access: Access;
  /** Bytes that are there, as far as that is known without reading on; null when it is not. */
  readonly size: number | null;
  /** Bytes that came from outside so far. */
  readonly bytesRead: number;
  /** Bytes from an offset on; fewer, or none, where the source ends. Whoever gets them does not write to them. */
  read(offset: number, length: number, signal?: AbortSignal): Promise<Uint8Array>;
  /** Makes later reads within this range quick, as far as memory may be used for it; gives up what it did before. */
  prefetch(offset: number, length: number): Promise<void>;
  /** Looks whether the source has grown; resolves to whether it has. */
  refresh(): Promise<boolean>;
  close(): void;
  /** Bytes that can be read without waiting, in order; without it, all can. */
  readonly held?: readonly Span[];
  /** What is wrong while it is tried again; null when nothing is. */
  readonly trouble?: string | null;
  /** Called when `held` or `trouble` has changed. */
  onChange?: (() => void) | null;
}

/** Bytes in memory. */
export class MemorySource implements ByteSource {
  readonly name = "the stream";
  readonly access = "local";
  private readonly bytes: Uint8Array;

  constructor(bytes: Uint8Array | ArrayBuffer) {
    this.bytes = bytes instanceof Uint8Array ? bytes : new Uint8Array(bytes);
  }

  get size(): number {
    return this.bytes.length;
  }

  get bytesRead(): number {
    return this.bytes.length;
  }

  read(offset: number, length: number): Promise<Uint8Array> {
    return Promise.resolve(this.bytes.subarray(offset, offset + length));
  }

  prefetch(): Promise<void> {
    return Promise.resolve();
  }

  refresh(): Promise<boolean> {
    return Promise.resolve(false);
  }

  close(): void {
    // Nothing is held that others do not hold.
  }
}
