/**
 * zstddec with its WebAssembly in a file of its own, which the page's build puts in place of the package: beside the
 * script it is compiled while it comes, and needs neither base64 nor a script that is twice as long.
 */

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
    const { exports } = await WebAssembly.instantiate(await compiled(), imports);
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

/** Begins when the script does, beside the stream's first request. */
const coming = fetch(new URL("./decogs-zstd.wasm", import.meta.url));
coming.catch(() => undefined); // whoever waits for it is told

async function compiled(): Promise<WebAssembly.Module> {
  const answer = await coming;
  if (!answer.ok) throw new Error(`decogs-zstd.wasm: HTTP ${answer.status}`);
  if (answer.headers.get("Content-Type") === "application/wasm") return WebAssembly.compileStreaming(answer);
  return WebAssembly.compile(await answer.arrayBuffer()); // a server that does not know the type
}
