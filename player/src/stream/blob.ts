/** Streams from a file that the user chose or dropped. */

import { StreamError } from "../container/errors";
import type { Feed } from "./cache";

export class BlobFeed implements Feed {
  readonly access = "local";

  constructor(private readonly blob: Blob) {}

  get name(): string {
    return this.blob instanceof File ? this.blob.name : "the file";
  }

  get size(): number {
    return this.blob.size;
  }

  async load(offset: number, length: number, _: AbortSignal, take: (piece: Uint8Array) => void): Promise<void> {
    try {
      take(new Uint8Array(await this.blob.slice(offset, offset + length).arrayBuffer()));
    } catch (error) {
      throw new StreamError(null, `${this.name} cannot be read: ${String(error)}`);
    }
  }

  /** A file that was chosen is what it was when it was chosen. */
  refresh(): Promise<boolean> {
    return Promise.resolve(false);
  }

  close(): void {
    // The browser owns the file.
  }
}
