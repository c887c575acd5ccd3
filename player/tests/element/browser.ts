/** A browser as far as sessions need it, in Node: a worker that says what tests have it say. Imported before what it is for. */
import type { FrameInfo, FromWorker, ToWorker } from "../../src/messages";
import type { StreamHeader } from "../../src/scene";

export class FakeWorker {
  /** The one that was asked to open a stream last. */
  static opened: FakeWorker;
  readonly sent: ToWorker[] = [];
  terminated = false;
  onmessage: ((event: { readonly data: FromWorker }) => void) | null = null;
  onerror: ((event: { readonly message: string }) => void) | null = null;

  postMessage(message: ToWorker): void {
    this.sent.push(message);
    if (message.type === "open") FakeWorker.opened = this;
  }

  terminate(): void {
    this.terminated = true;
  }

  say(message: FromWorker): void {
    this.onmessage?.({ data: message });
  }

  die(message = "out of memory"): void {
    this.onerror?.({ message });
  }

  asked<T extends ToWorker["type"]>(type: T): Extract<ToWorker, { type: T }>[] {
    return this.sent.filter((message): message is Extract<ToWorker, { type: T }> => message.type === type);
  }
}

export const header = (changed: Partial<StreamHeader> = {}): StreamHeader =>
  ({ cameras: [], fps: 30, sound: [], layers: [], presentation: { title: "", poster: null, firstView: null, transform: null }, ...changed }) as unknown as StreamHeader;

export const info = (frame: number, changed: Partial<FrameInfo> = {}): FrameInfo =>
  ({ frame, kind: "delta", bytes: 100, layer: 0, damage: null, count: 1, changed: 0, added: 0, removed: 0, decodeMs: 1, packMs: 0, corrections: new Map(), ...changed });

export const frameTable = (count: number, from = 0) => ({ from, kinds: new Uint8Array(count - from), bytes: new Uint32Array(count - from) });

/** Lets everything go on that waits for nothing but its turn. */
export const turn = (): Promise<void> => new Promise((done) => setImmediate(done));

// Scripts of this one's own origin, which is that of files.
Object.assign(globalThis, { Worker: FakeWorker, window: globalThis, location: { origin: "null" } });
