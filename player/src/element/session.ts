/** One stream's life: what the worker says of it, which frame is due, seeking, and following a file that grows. */
import type { FrameInfo, FromWorker, ToWorker } from "../messages";
import type { StreamHeader } from "../scene";
import { Connection, FrameColumns } from "./connection";
import type { PlayerEvent } from "./events";
import type { Pictures } from "./pictures";
import { DEFAULT_FPS, Playback } from "./playback";

const FOLLOW_MS = 1000;

/** Where to begin: set before the header has come. */
export type Start = { readonly seconds: number } | { readonly frame: number };

export interface SessionHost {
  readonly tell: (name: PlayerEvent) => void;
  readonly wake: () => void;
  readonly loading: (on: boolean) => void;
  /** Says the worst of what is wrong, as long as it is. */
  readonly warn: (text: string | null) => void;
  /** The stream's header has come: cameras can be put up. */
  readonly opened: (header: StreamHeader) => void;
  readonly autoplay: () => boolean;
}

export class Session {
  header: StreamHeader | null = null;
  /** Of the frame in the picture. */
  info: FrameInfo | null = null;
  /** What went wrong, a sentence; null when nothing. */
  error: string | null = null;
  frames = new FrameColumns();
  bytesRead = 0;
  drawn = { count: 0, sortMs: 0 };
  /** Where the next stream begins, as with <video>. */
  start: Start | null = null;
  readonly playback = new Playback();
  #connection: Connection | null = null;
  #pictures: Pictures | null = null;
  #follow = false;
  #requested = -1;
  #requests = 0;
  #seekRequest = -1;
  /** A frame asked for that is not known yet; -1 for none. */
  #seekLater = -1;
  #followTimer = 0;
  #notice: string | null = null;

  constructor(private readonly host: SessionHost) {}

  open(source: string, follow: boolean, pictures: Pictures): void {
    this.#pictures = pictures;
    this.#follow = follow;
    this.host.loading(true);
    const { start } = this;
    const first = start === null ? 0 : "frame" in start ? start.frame : null;
    this.#requested = first ?? -1;
    this.#connection = new Connection(
      source,
      follow,
      first,
      (message) => {
        this.#receive(message);
      },
      (message) => {
        this.fail(message);
      },
    );
  }

  close(): void {
    clearTimeout(this.#followTimer);
    this.#connection?.close();
    this.#connection = null;
    this.header = this.info = this.error = this.#notice = null;
    this.warn();
    this.frames = new FrameColumns();
    this.#requested = this.#seekRequest = this.#seekLater = -1;
    this.bytesRead = 0;
    Object.assign(this.playback, { playing: false, ended: false, position: 0, frameCount: 0, complete: false });
  }

  send(message: ToWorker): void {
    this.#connection?.send(message);
  }

  /** Goes on by some seconds, and asks for the frame that is due. */
  advance(seconds: number): void {
    const { playback } = this;
    const wasPlaying = playback.playing;
    playback.advance(seconds, this.info?.frame ?? playback.due);
    if (playback.frameCount > 0 && playback.due !== this.#requested) this.#request(playback.due);
    if (!wasPlaying || !playback.ended) return;
    this.host.tell("pause");
    this.host.tell("ended");
  }

  play(): void {
    const { playback } = this;
    if (playback.ended || (playback.complete && playback.due >= playback.frameCount - 1)) this.seek(0);
    playback.playing = true;
    playback.ended = false;
    this.host.tell("play");
    this.host.wake();
  }

  pause(): void {
    if (!this.playback.playing) return;
    this.playback.playing = false;
    this.host.tell("pause");
  }

  /** Goes to a frame, counted in frames and parts of them. */
  seek(frame: number): void {
    const { playback } = this;
    if (this.header === null || !Number.isFinite(frame)) return;
    this.#seekLater = frame >= playback.frameCount && !playback.complete ? frame : -1;
    playback.position = Math.max(0, Math.min(frame, playback.frameCount - 1));
    playback.ended = false;
    this.host.tell("seeking");
    this.#seekRequest = this.#requests + 1;
    this.#request(playback.due);
    this.host.wake();
  }

  fail(message: string): void {
    this.error = message;
    this.host.loading(false);
    this.warn();
    this.pause();
    this.host.tell("error");
  }

  /** Says something of the stream until the worker says something else. */
  notice(text: string | null): void {
    this.#notice = text;
    this.warn();
  }

  warn(): void {
    this.host.warn(this.error ?? this.info?.damage ?? this.#notice);
  }

  #receive(message: FromWorker): void {
    switch (message.type) {
      case "opened":
        this.#opened(message);
        break;
      case "progress":
        this.bytesRead = message.bytesRead;
        if (message.frames !== null) this.frames.append(message.frames);
        for (const [frame, psnr] of message.psnr) this.frames.psnr.set(frame, psnr);
        this.#grown(message.complete);
        this.notice(message.notices.at(-1) ?? null);
        this.host.tell("progress");
        break;
      case "frame":
        this.#shown(message);
        break;
      case "order":
        this.#pictures!.stage.order(message.draw);
        this.#sorted(message.draw);
        this.#recycle(message.draw.order);
        break;
      case "exact":
        this.#pictures!.exactlyDrawn(message.picture);
        if (message.problem !== null) this.notice(message.problem);
        break;
      case "notYet":
        this.#requested = -1;
        break;
      case "refreshed":
        this.#followSoon();
        break;
      case "failed":
        this.fail(message.message);
    }
    this.host.wake();
  }

  #opened({ header, layout, frames, complete }: Extract<FromWorker, { type: "opened" }>): void {
    const { stage } = this.#pictures!;
    this.header = header;
    this.frames.append(frames);
    this.playback.fps = header.fps ?? DEFAULT_FPS;
    this.#pictures!.begin(layout, header);
    this.host.opened(header);
    stage.begin();
    const { start } = this;
    this.start = null;
    this.#grown(complete);
    if (start !== null) this.seek("frame" in start ? start.frame : start.seconds * this.playback.fps);
    this.host.tell("loadedmetadata");
    if (this.host.autoplay()) this.play();
    this.#followSoon();
  }

  #grown(complete: boolean): void {
    const { playback, frames } = this;
    const longer = frames.count !== playback.frameCount;
    playback.frameCount = frames.count;
    playback.complete = complete;
    if (longer) this.host.tell("durationchange");
    if (this.#seekLater >= 0 && (this.#seekLater < frames.count || complete)) this.seek(this.#seekLater);
  }

  #shown(message: Extract<FromWorker, { type: "frame" }>): void {
    const { info, update, draw } = message;
    const first = this.info === null;
    const steps = Math.abs(info.frame - (this.info?.frame ?? info.frame));
    if (message.request >= 0) this.playback.note(info.decodeMs + info.packMs + draw.sortMs, steps);
    this.info = info;
    this.#pictures!.stage.load(update, draw);
    this.#sorted(draw);
    this.#recycle(draw.order, update?.base, update?.rest, update?.heat, update?.part?.places);
    this.warn();
    if (first) {
      this.host.loading(false);
      this.host.tell("loadeddata");
    }
    this.host.tell("timeupdate");
    if (this.#seekRequest >= 0 && message.request >= this.#seekRequest) {
      this.#seekRequest = -1;
      this.host.tell("seeked");
    }
  }

  #sorted({ count, sortMs }: { readonly count: number; readonly sortMs: number }): void {
    this.drawn = { count, sortMs };
  }

  #recycle(...arrays: (Uint32Array | Uint8Array | null | undefined)[]): void {
    const buffers = arrays.flatMap((array) => (array ? [array.buffer as ArrayBuffer] : []));
    const whole = buffers.filter((buffer) => buffer.byteLength > 0);
    this.#connection?.send({ type: "recycle", buffers: whole }, whole);
  }

  #request(frame: number): void {
    this.#requested = frame;
    this.send({ type: "show", frame, request: ++this.#requests });
  }

  #followSoon(): void {
    clearTimeout(this.#followTimer);
    if (this.playback.complete || !this.#follow) return;
    this.#followTimer = window.setTimeout(() => {
      this.send({ type: "refresh" });
    }, FOLLOW_MS);
  }
}
