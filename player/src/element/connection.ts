/** The page's end of the worker: messages out, messages in, and tables of frames that grow. */
import { FRAME_KINDS, type FrameTable, type FromWorker, type ToWorker } from "../messages";
import type { FrameKind } from "../scene";

/** Columns of what is known of every frame. */
export class FrameColumns {
  count = 0;
  kinds = new Uint8Array(256);
  bytes = new Uint32Array(256);
  readonly psnr = new Map<number, number>();

  append(table: FrameTable): void {
    const count = table.from + table.kinds.length;
    if (count > this.kinds.length) {
      const [kinds, bytes] = [this.kinds, this.bytes];
      this.kinds = new Uint8Array(2 * count);
      this.bytes = new Uint32Array(2 * count);
      this.kinds.set(kinds);
      this.bytes.set(bytes);
    }
    this.kinds.set(table.kinds, table.from);
    this.bytes.set(table.bytes, table.from);
    this.count = count;
  }

  kind(frame: number): FrameKind | null {
    return FRAME_KINDS[this.kinds[frame]];
  }

  /** The keyframe at or before a frame, or the next one after it; the frame itself where there is none. */
  keyframe(frame: number, direction: -1 | 1): number {
    for (let at = frame + direction; at >= 0 && at < this.count; at += direction) if (this.kinds[at] === 0) return at;
    return frame;
  }
}

export class Connection {
  private readonly worker: Worker;

  constructor(receive: (message: FromWorker) => void, failed: (message: string) => void) {
    this.worker = startedWorker();
    this.worker.onmessage = (event: MessageEvent<FromWorker>) => {
      receive(event.data);
    };
    this.worker.onerror = (event) => {
      failed(event.message || "the player's worker (decogs-worker.js) cannot be loaded");
    };
  }

  send(message: ToWorker, transfer: Transferable[] = []): void {
    this.worker.postMessage(message, transfer);
  }

  close(): void {
    this.send({ type: "close" });
    this.worker.terminate();
  }
}

/** The worker's script lies beside this one. One of another origin is reached through a small one of the page's own. */
function startedWorker(): Worker {
  const url = new URL("./decogs-worker.js", import.meta.url);
  if (url.origin === location.origin) return new Worker(url, { type: "module" });
  const script = new Blob([`import ${JSON.stringify(url.href)};`], { type: "text/javascript" });
  const address = URL.createObjectURL(script);
  const worker = new Worker(address, { type: "module" });
  setTimeout(() => {
    URL.revokeObjectURL(address);
  }, 60_000);
  return worker;
}
