/** Streams from a server: by ranges where it knows them, else as one download after the other. */

import { StreamError } from "../container/errors";
import type { Feed } from "./cache";

/** Waits before a request that failed is tried again, in milliseconds. */
const RETRIES = [250, 1000];
const LATER_MS = 2000;

/** A feed for an address; whether the server knows ranges is found out by asking for the first one. */
export class HttpFeed implements Feed {
  size: number | null = null;
  trouble: string | null = null;
  onTrouble?: () => void;
  /** Pieces that have come from there. */
  private pieces = 0;
  /** Whether the first bytes are asked for without a range. */
  private asPlain = false;
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
    private readonly credentials: RequestCredentials = "same-origin",
  ) {}

  get name(): string {
    return this.address;
  }

  get access(): "ranges" | "sequential" {
    return this.ranges === false ? "sequential" : "ranges";
  }

  async load(offset: number, length: number, signal: AbortSignal, take: (piece: Uint8Array) => void): Promise<void> {
    let come = 0;
    const counted = (piece: Uint8Array): void => {
      come += piece.length;
      this.tellTrouble(null);
      this.pieces++;
      take(piece);
    };
    // What has come before a connection broke is not asked for again.
    await this.again(async () => {
      if (come < length) await this.loadPart(offset + come, length - come, signal, counted);
    }, signal);
  }

  async refresh(): Promise<boolean> {
    const before = this.size;
    if (before === null) return false;
    this.grows = true;
    const now = await this.again(() => this.wholeSize(), new AbortController().signal);
    this.tellTrouble(null);
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

  private async loadPart(offset: number, length: number, signal: AbortSignal, take: (piece: Uint8Array) => void): Promise<void> {
    if (this.ranges === false) return this.inTurn(() => this.readOn(offset, length, take));
    const answer = await this.request(this.asPlain ? {} : rangeOf(offset, length), signal);
    if (answer.status === 200 && this.asPlain && answer.headers.get("Accept-Ranges") === "bytes" && lengthOf(answer) !== null) {
      // It was the connection, not the range, that failed before.
      this.asPlain = false;
      await answer.body?.cancel();
      return this.loadPart(offset, length, signal, take);
    }
    if (answer.status === 206 && answer.headers.has("Content-Encoding")) {
      // A part of what is stored compressed can be unpacked by nobody.
      await answer.body?.cancel();
      this.ranges = false;
      return this.inTurn(() => this.readOn(offset, length, take));
    }
    if (answer.status === 200) {
      // No ranges: this is the whole file from its start.
      this.ranges = false;
      this.size = lengthOf(answer);
      this.download = new Download(answer);
      return this.inTurn(() => this.readOn(offset, length, take));
    }
    this.ranges = true;
    if (answer.status === 416) {
      await answer.body?.cancel();
      this.size ??= offset;
      return;
    }
    this.check(answer, offset);
    // Another site's server may not let scripts see how large the whole is.
    this.size ??= totalOf(answer) ?? (await this.wholeSize());
    let come = 0;
    const download = new Download(answer);
    try {
      come = await download.take(length, take);
      void download.finish();
    } catch (error) {
      throw signal.aborted ? signal.reason : this.broken(String(error), true, true);
    }
    if (come < length && offset + come < (this.size ?? Infinity)) throw this.broken("the connection ended too early", true);
  }

  /** A part must begin where it was asked for, and belong to the same file as the parts before. */
  private check(answer: Response, offset: number): void {
    const match = /^bytes (\d+)-/.exec(answer.headers.get("Content-Range") ?? "");
    if (match !== null && Number(match[1]) !== offset) throw this.broken("the server sent another part than asked for");
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
  private async readOn(offset: number, length: number, take: (piece: Uint8Array) => void): Promise<void> {
    const { signal } = new AbortController();
    if (this.download === null || this.download.position > offset || this.download.failed) {
      void this.download?.stop();
      this.download = new Download(await this.request({}, signal));
      this.size = lengthOf(this.download.answer) ?? this.size;
    }
    const { download } = this;
    try {
      await download.pass(offset - download.position);
      const come = await download.take(length, take);
      if (come < length) this.size ??= download.position;
    } catch (error) {
      throw this.broken(String(error), true);
    }
  }

  private async request(init: RequestInit, signal: AbortSignal): Promise<Response> {
    if (this.closed) throw this.broken("the stream is closed");
    let answer: Response;
    try {
      answer = await fetch(this.address, { ...init, signal, credentials: this.credentials, cache: this.grows ? "no-store" : "default" });
    } catch (error) {
      throw signal.aborted ? signal.reason : this.broken(`${reasonOf(error)} (the network is gone, or the other server forbids it: CORS)`, true, true);
    }
    if (!answer.ok && answer.status !== 416) {
      await answer.body?.cancel();
      throw this.broken(`the server answers ${answer.status} ${answer.statusText}`, answer.status >= 500);
    }
    return answer;
  }

  /**
   * Tries again what may pass: for as long as it takes, once something has come from there; else a few times, since the
   * address may be wrong.
   */
  private async again<T>(work: () => Promise<T>, signal: AbortSignal): Promise<T> {
    for (let tries = 0, before = this.pieces; ; tries++) {
      try {
        return await work();
      } catch (error) {
        if (signal.aborted || this.closed || !(error instanceof BrokenConnection) || !error.mayPass) throw error;
        if (this.pieces > before) [tries, before] = [0, this.pieces];
        const answered = this.pieces > 0;
        if (!answered && tries >= this.retries.length) throw error;
        if (!answered && error.unanswered) this.asPlain = !this.asPlain; // ranges of what is stored compressed fail like a connection
        if (tries > 0) this.tellTrouble(error.message);
        await pause(this.retries[tries] ?? LATER_MS, signal);
      }
    }
  }

  private tellTrouble(trouble: string | null): void {
    if (trouble === this.trouble) return;
    this.trouble = trouble;
    this.onTrouble?.();
  }

  private broken(what: string, mayPass = false, unanswered = false): BrokenConnection {
    return new BrokenConnection(`${this.address} cannot be read: ${what}`, mayPass, unanswered);
  }
}

class BrokenConnection extends StreamError {
  /** `mayPass`: whether trying again may help. */
  constructor(
    message: string,
    readonly mayPass: boolean,
    /** Whether there was no answer, or none that could be read. */
    readonly unanswered: boolean,
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

  /** The next bytes, in the pieces that come; fewer at the end. What the answer has beyond them stays where it is. */
  async take(length: number, take: (piece: Uint8Array) => void): Promise<number> {
    let left = length;
    while (left > 0 && (await this.fill())) {
      const part = this.rest.subarray(0, left);
      take(part);
      left -= part.length;
      this.advance(part.length);
    }
    return length - left;
  }

  /** Goes past so many bytes without keeping them. */
  async pass(length: number): Promise<void> {
    for (let left = length; left > 0 && (await this.fill()); ) {
      const part = Math.min(left, this.rest.length);
      this.advance(part);
      left -= part;
    }
  }

  /** Reads to the end, where it is expected: then the connection serves the next request. */
  async finish(): Promise<void> {
    const more = await this.fill().catch(() => false);
    if (more) await this.stop();
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
        const chunk = await this.reader?.read();
        if (chunk?.value === undefined) return false;
        this.rest = chunk.value as Uint8Array<ArrayBuffer>;
      } catch (error) {
        this.failed = true;
        throw error;
      }
    }
    return true;
  }
}

/** What browsers say for anything that goes wrong on the way tells nobody anything. */
function reasonOf(error: unknown): string {
  return error instanceof TypeError ? "there is no answer" : String(error);
}

/** Node has no such events. */
const network: Partial<Pick<typeof globalThis, "addEventListener" | "removeEventListener">> = globalThis;

/** Waits, but not when the signal comes or the network is back. */
function pause(milliseconds: number, signal: AbortSignal): Promise<void> {
  return new Promise((done) => {
    const end = (): void => {
      clearTimeout(timer);
      signal.removeEventListener("abort", end);
      network.removeEventListener?.("online", end);
      done();
    };
    const timer = setTimeout(end, milliseconds);
    signal.addEventListener("abort", end);
    network.addEventListener?.("online", end);
  });
}

function rangeOf(offset: number, length: number): RequestInit {
  return { headers: { Range: `bytes=${offset}-${offset + length - 1}` } };
}

/** Of a part: the whole file's size, where it is told. */
function totalOf(answer: Response): number | null {
  const match = /\/(\d+)$/.exec(answer.headers.get("Content-Range") ?? "");
  return match === null ? null : Number(match[1]);
}

/** Of a whole file; not told where the transfer compresses it. */
function lengthOf(answer: Response): number | null {
  const length = answer.headers.get("Content-Length");
  return length === null || answer.headers.has("Content-Encoding") ? null : Number(length);
}
