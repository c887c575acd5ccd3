/** The page's end of the worker: messages out, messages in, and tables of frames that grow. */
import { kernelBytes } from "../exact/bytes";
import { FRAME_KINDS, type FrameTable, type FromWorker, type Opening, type ToWorker } from "../messages";
import type { FrameKind } from "../scene";
import { ownScript } from "../trusted";
import { address, text } from "./worker_script";

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
  readonly messages: FromWorker[];
  readonly failed: boolean;
}

declare global {
  var decogsEarly: Early | undefined;
}

/** A worker takes longer to start than a header to come: one waits for the first stream from the time the script runs. */
let spare: Worker | null = globalThis.decogsEarly === undefined ? spareWorker() : null;

export class Connection {
  private readonly worker: Worker;
  /** What an early worker said before this heard it. */
  private readonly earlier: FromWorker[];

  /** Opens a stream. Throws where no worker can be started. */
  constructor(opening: Opening, receive: (message: FromWorker) => void, failed: (message: string) => void) {
    const early = earlyFor(opening);
    this.worker = early?.worker ?? spare ?? startedWorker();
    spare = null;
    this.earlier = early?.messages ?? [];
    const hearEarlier = (): void => {
      for (let message = this.earlier.shift(); message !== undefined; message = this.earlier.shift()) receive(message);
    };
    this.worker.onmessage = (event: MessageEvent<FromWorker>) => {
      hearEarlier();
      if (event.data.type === "kernel") void this.giveKernel();
      else receive(event.data);
    };
    this.worker.onerror = (event) => {
      failed(event.message || notStarted(`${address === null ? "" : `${address} is missing, or `}the page's Content-Security-Policy forbids it (worker-src)`));
    };
    if (early === null) this.send({ type: "open", ...opening });
    else setTimeout(hearEarlier); // as messages come: not before whoever opens the stream is done
  }

  send(message: ToWorker, transfer: Transferable[] = []): void {
    this.worker.postMessage(message, transfer);
  }

  /** Gives buffers back that nobody needs any more, for the worker to fill again. */
  recycle(...arrays: (Uint32Array | Uint8Array | null | undefined)[]): void {
    const buffers = arrays.flatMap((array) => (array ? [array.buffer as ArrayBuffer] : []));
    const whole = buffers.filter((buffer) => buffer.byteLength > 0);
    this.send({ type: "recycle", buffers: whole }, whole);
  }

  private async giveKernel(): Promise<void> {
    try {
      const bytes = await kernelBytes();
      this.send({ type: "kernel", bytes, problem: "" }, [bytes]);
    } catch (error) {
      this.send({ type: "kernel", bytes: null, problem: error instanceof Error ? error.message : String(error) });
    }
  }

  close(): void {
    this.earlier.length = 0;
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

/** null on a server, which has no page, and where none can be started: whoever opens the stream tries again, and hears why. */
function spareWorker(): Worker | null {
  if (typeof document === "undefined") return null;
  try {
    const worker = startedWorker();
    worker.onerror = () => (spare = null);
    return worker;
  } catch {
    return null;
  }
}

/** A worker of the script's address, or, where the page may start none from there, of its text. */
function startedWorker(): Worker {
  try {
    if (address !== null) return new Worker(ownScript(address), { type: "module" });
    const own = URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
    setTimeout(() => {
      URL.revokeObjectURL(own);
    }, 60_000);
    return new Worker(ownScript(own));
  } catch (error) {
    throw new Error(notStarted(error instanceof Error ? error.message : String(error)));
  }
}

function notStarted(why: string): string {
  const frame = globalThis.origin === "null" ? "; the page is in a frame whose sandbox leaves it no origin of its own (allow-same-origin)" : "";
  return `the player's worker cannot be started: ${why}${frame}`;
}
