/** Where a stream's bytes come from. */

/** Bytes by their offset. All methods reject with a StreamError where bytes cannot be had. */
export interface ByteSource {
  /** For messages. */
  readonly name: string;
  /** Bytes that are there, as far as that is known without reading on; null when it is not. */
  readonly size: number | null;
  /** Whether reading all of it costs little. */
  readonly isLocal: boolean;
  /** Bytes that came from outside so far. */
  readonly bytesRead: number;
  /** Bytes from an offset on; fewer, or none, where the source ends. Whoever gets them does not write to them. */
  read(offset: number, length: number, signal?: AbortSignal): Promise<Uint8Array>;
  /** Makes later reads within this range quick, as far as memory is allowed to be used for it. */
  prefetch(offset: number, length: number): Promise<void>;
  /** Looks whether the source has grown; resolves to whether it has. */
  refresh(): Promise<boolean>;
  close(): void;
}

/** Bytes in memory. */
export class MemorySource implements ByteSource {
  readonly name = "stream";
  readonly isLocal = true;
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
