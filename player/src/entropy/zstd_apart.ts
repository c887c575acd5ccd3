/**
 * zstddec with its WebAssembly apart, which the builds put in place of that package (build.mjs): it would fetch its own from a
 * `data:` address, which a page's Content-Security-Policy may forbid.
 */

import { compiler } from "../kernel/fetched";
import source from "./zstd.wasm";

const compile = compiler(source);

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
    const { exports } = await WebAssembly.instantiate(await compile(), imports);
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

