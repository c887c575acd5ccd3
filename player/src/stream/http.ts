/** Streams from a server: by ranges where it knows them, else as one download after the other. */

import { StreamError } from "../container/errors";
import { joined } from "./bytes";
import type { Feed } from "./cache";

/** Waits before a request that failed is tried again, in milliseconds. */
const RETRIES = [250, 1000];

/** A feed for an address; whether the server knows ranges is found out by asking for the first one. */
export class HttpFeed implements Feed {
  size: number | null = null;
  private ranges: boolean | null = null;
  private version: string | null = null;
  private download: Download | null = null;
  /** Downloads are read by one at a time. */
  private turn: Promise<unknown> = Promise.resolve();
  private closed = false;

  /** `grows`: the file may be another one each time, as long as what was there stays. */
  constructor(
    private readonly address: string,
    private grows: boolean,
    private readonly retries: readonly number[] = RETRIES,
  ) {}

  get name(): string {
    return this.address;
  }

  get access(): "ranges" | "sequential" {
    return this.ranges === false ? "sequential" : "ranges";
  }

  async load(offset: number, length: number, signal: AbortSignal): Promise<Uint8Array> {
    if (length <= 0) return new Uint8Array(0);
    if (this.ranges === false) return this.inTurn(() => this.readOn(offset, length));
    return this.again(() => this.loadRange(offset, length, signal), signal);
  }

  async refresh(): Promise<boolean> {
    const before = this.size;
    if (before === null) return false;
    this.grows = true;
    const now = await this.wholeSize();
    if (now === null) return false;
    if (now < before) throw this.broken("the file was cut back meanwhile; open it again");
    this.size = now;
    return now > before;
  }

  close(): void {
    this.closed = true;
    void this.download?.stop();
  }

  private inTurn<T>(work: () => Promise<T>): Promise<T> {
    const turn = this.turn.then(work);
    this.turn = turn.catch(() => undefined);
    return turn;
  }

  private async loadRange(offset: number, length: number, signal: AbortSignal): Promise<Uint8Array> {
    const answer = await this.request(rangeOf(offset, length), signal);
    if (answer.status === 200) {
      // No ranges: this is the whole file from its start.
      this.ranges = false;
      this.size = lengthOf(answer);
      this.download = new Download(answer);
      return this.inTurn(() => this.readOn(offset, length));
    }
    this.ranges = true;
    if (answer.status === 416) {
      await answer.body?.cancel();
      this.size ??= offset;
      return new Uint8Array(0);
    }
    this.check(answer, offset);
    // Another site's server may not let scripts see how large the whole is.
    this.size ??= totalOf(answer) ?? (await this.wholeSize());
    const bytes = await this.bodyOf(answer, length, signal);
    if (bytes.length < length && offset + bytes.length < (this.size ?? Infinity)) {
      throw this.broken("the connection ended too early", true);
    }
    return bytes;
  }

  private async bodyOf(answer: Response, length: number, signal: AbortSignal): Promise<Uint8Array> {
    try {
      return await new Download(answer).take(length);
    } catch (error) {
      throw signal.aborted ? signal.reason : this.broken(String(error), true);
    }
  }

  /** A part must begin where it was asked for, and belong to the same file as the parts before. */
  private check(answer: Response, offset: number): void {
    const told = /^bytes (\d+)-/.exec(answer.headers.get("Content-Range") ?? "");
    if (told !== null && Number(told[1]) !== offset) throw this.broken("the server sent another part than asked for");
    const version = answer.headers.get("ETag") ?? answer.headers.get("Last-Modified");
    if (!this.grows && this.version !== null && version !== this.version) {
      throw this.broken("the file has changed on the server; open it again");
    }
    this.version = version;
  }

  private async wholeSize(): Promise<number | null> {
    const answer = await this.request({ method: "HEAD" }, new AbortController().signal);
    return lengthOf(answer);
  }

  /**
   * The next bytes of the download, which is begun anew for what lies behind it. No signal: what was begun is read to
   * its end, since giving it up would mean to start from the file's first byte again.
   */
  private async readOn(offset: number, length: number): Promise<Uint8Array> {
    const { signal } = new AbortController();
    if (this.download === null || this.download.position > offset || this.download.failed) {
      void this.download?.stop();
      this.download = new Download(await this.again(() => this.request({}, signal), signal));
      this.size = lengthOf(this.download.answer) ?? this.size;
    }
    const { download } = this;
    try {
      await download.pass(offset - download.position);
      const bytes = await download.take(length);
      if (bytes.length < length) this.size ??= download.position;
      return bytes;
    } catch (error) {
      throw this.broken(String(error), true);
    }
  }

  private async request(init: RequestInit, signal: AbortSignal): Promise<Response> {
    if (this.closed) throw this.broken("the stream is closed");
    let answer: Response;
    try {
      answer = await fetch(this.address, { ...init, signal, cache: this.grows ? "no-store" : "default" });
    } catch (error) {
      throw signal.aborted ? signal.reason : this.broken(String(error), true);
    }
    if (!answer.ok && answer.status !== 416) {
      await answer.body?.cancel();
      throw this.broken(`the server answers ${answer.status} ${answer.statusText}`, answer.status >= 500);
    }
    return answer;
  }

  private async again<T>(work: () => Promise<T>, signal: AbortSignal): Promise<T> {
    for (const wait of this.retries) {
      try {
        return await work();
      } catch (error) {
        if (signal.aborted || this.closed || !(error instanceof BrokenConnection) || !error.mayPass) throw error;
        await new Promise((resolve) => setTimeout(resolve, wait));
      }
    }
    return work();
  }

  private broken(what: string, mayPass = false): BrokenConnection {
    return new BrokenConnection(`${this.address} cannot be read: ${what}`, mayPass);
  }
}

class BrokenConnection extends StreamError {
  /** `mayPass`: whether trying again may help. */
  constructor(
    message: string,
    readonly mayPass: boolean,
  ) {
    super(null, message);
  }
}

/** The body of an answer, read as far as it is needed: what is not asked for yet waits at the server. */
class Download {
  position = 0;
  failed = false;
  private readonly reader: ReadableStreamDefaultReader<Uint8Array> | null;
  private rest = new Uint8Array(0);

  constructor(readonly answer: Response) {
    this.reader = answer.body?.getReader() ?? null;
  }

  /** The next bytes; fewer at the end. What the answer has beyond them stays where it is. */
  async take(length: number): Promise<Uint8Array> {
    // In the pieces that come: a length that a damaged stream tells sets no memory aside by itself.
    const parts: Uint8Array[] = [];
    for (let left = length; left > 0 && (await this.fill()); ) {
      const part = this.rest.subarray(0, left);
      parts.push(part);
      left -= part.length;
      this.advance(part.length);
    }
    return joined(parts);
  }

  /** Goes past so many bytes without keeping them. */
  async pass(length: number): Promise<void> {
    for (let left = length; left > 0 && (await this.fill()); ) {
      const part = Math.min(left, this.rest.length);
      this.advance(part);
      left -= part;
    }
  }

  private advance(bytes: number): void {
    this.rest = this.rest.subarray(bytes);
    this.position += bytes;
  }

  async stop(): Promise<void> {
    await this.reader?.cancel().catch(() => undefined);
  }

  private async fill(): Promise<boolean> {
    while (this.rest.length === 0) {
      try {
        const found = await this.reader?.read();
        if (found?.value === undefined) return false;
        this.rest = found.value as Uint8Array<ArrayBuffer>;
      } catch (error) {
        this.failed = true;
        throw error;
      }
    }
    return true;
  }
}

function rangeOf(offset: number, length: number): RequestInit {
  return { headers: { Range: `bytes=${offset}-${offset + length - 1}` } };
}

/** Of a part: the whole file's size, where it is told. */
function totalOf(answer: Response): number | null {
  const told = /\/(\d+)$/.exec(answer.headers.get("Content-Range") ?? "");
  return told === null ? null : Number(told[1]);
}

/** Of a whole file; not told where the transfer compresses it. */
function lengthOf(answer: Response): number | null {
  const told = answer.headers.get("Content-Length");
  return told === null || answer.headers.has("Content-Encoding") ? null : Number(told);
}
