/** The page's end of the worker: messages out, messages in, and tables of frames that grow. */
import { FRAME_KINDS, type FrameTable, type FromWorker, type Opening, type ToWorker } from "../messages";
import type { FrameKind } from "../scene";
import { ownScript } from "../trusted";

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

/** A worker that a page began before this script had come (static/index.html), and what it has said since. */
interface Early {
  readonly worker: Worker;
  readonly source: string;
  readonly follow: boolean;
  readonly first: number;
  readonly said: FromWorker[];
  readonly failed: boolean;
}

declare global {
  var decogsEarly: Early | undefined;
}

/** A worker takes longer to start than a header to come: one waits for the first stream from the time the script runs. */
let spare: Worker | null = globalThis.decogsEarly === undefined ? startedWorker() : null;
// Nobody hears why yet: whoever opens the stream tries again, and does.
if (spare !== null) spare.onerror = () => (spare = null);

export class Connection {
  private readonly worker: Worker;
  /** What an early worker said before this heard it. */
  private readonly said: FromWorker[];

  /** Opens a stream. */
  constructor(opening: Opening, receive: (message: FromWorker) => void, failed: (message: string) => void) {
    const early = earlyFor(opening);
    this.worker = early?.worker ?? spare ?? startedWorker();
    spare = null;
    this.said = early?.said ?? [];
    const hearEarlier = (): void => {
      for (let said = this.said.shift(); said !== undefined; said = this.said.shift()) receive(said);
    };
    this.worker.onmessage = (event: MessageEvent<FromWorker>) => {
      hearEarlier();
      receive(event.data);
    };
    this.worker.onerror = (event) => {
      failed(event.message || "the player's worker (decogs-worker.js) cannot be loaded");
    };
    if (early === null) this.send({ type: "open", ...opening });
    else setTimeout(hearEarlier); // as messages come: not before whoever opens the stream is done
  }

  send(message: ToWorker, transfer: Transferable[] = []): void {
    this.worker.postMessage(message, transfer);
  }

  close(): void {
    this.said.length = 0;
    this.worker.onmessage = this.worker.onerror = null;
    this.send({ type: "close" });
    this.worker.terminate();
  }
}

/** What was begun early, if it is this stream; it is there once. */
function earlyFor({ source, follow, first, credentials }: Opening): Early | null {
  const early = globalThis.decogsEarly;
  globalThis.decogsEarly = undefined;
  if (early === undefined) return null;
  if (!early.failed && early.source === source && early.follow === follow && early.first === first && credentials === undefined) return early;
  early.worker.terminate();
  return null;
}

/** The worker's script lies beside this one. One of another origin is reached through a small one of the page's own. */
function startedWorker(): Worker {
  // In this very form, which bundlers know.
  const { href, origin } = new URL("./decogs-worker.js", import.meta.url);
  if (origin === location.origin) return new Worker(ownScript(href), { type: "module" });
  const script = new Blob([`import ${JSON.stringify(href)};`], { type: "text/javascript" });
  const own = URL.createObjectURL(script);
  const worker = new Worker(ownScript(own), { type: "module" });
  setTimeout(() => {
    URL.revokeObjectURL(own);
  }, 60_000);
  return worker;
}
