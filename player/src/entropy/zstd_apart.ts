/**
 * zstddec with its WebAssembly in a file of its own, which the page's build puts in place of the package: beside the
 * script it is compiled while it comes, and needs neither base64 nor a script that is twice as long.
 */

import { compiledFrom, fetched } from "../kernel/fetched";

const coming = fetched("./decogs-zstd.wasm");

interface Library {
  readonly memory: WebAssembly.Memory;
  readonly malloc: (bytes: number) => number;
  readonly free: (address: number) => void;
  readonly ZSTD_decompress: (to: number, room: number, from: number, length: number) => number;
}

export class ZSTDDecoder {
  private zstd: Library | null = null;

  async init(): Promise<void> {
    const imports = { env: { emscripten_notify_memory_growth: () => undefined } };
    const { exports } = await WebAssembly.instantiate(await compiledFrom(coming), imports);
    this.zstd = exports as unknown as Library;
  }

  /** The content of a frame, at most `room` bytes. */
  decode(data: Uint8Array, room: number): Uint8Array {
    const { memory, malloc, free, ZSTD_decompress } = this.zstd!;
    const from = malloc(data.length);
    const to = malloc(room);
    new Uint8Array(memory.buffer).set(data, from);
    const length = ZSTD_decompress(to, room, from, data.length);
    const content = new Uint8Array(memory.buffer).slice(to, to + length);
    free(from);
    free(to);
    return content;
  }
}

