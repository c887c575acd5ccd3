/** One stream's life: what the worker says of it, which frame is due, seeking, and following a file that grows. */
import type { PinholeCamera } from "../geometry/camera";
import { inItsWorld } from "../geometry/similarity";
import { NO_ANSWER, type DrawOrder, type ExactAnswer, type ExactPicture, type FrameInfo, type FromWorker, type Opening, type SceneUpdate, type TextureLayout, type ToWorker } from "../messages";
import type { StreamHeader } from "../scene";
import { Answers } from "./answers";
import { Connection, FrameColumns } from "./connection";
import type { PlayerEvent } from "./events";
import type { Span } from "../player_api";
import { DEFAULT_FPS, Playback } from "./playback";
import { LateSound } from "../sound/late";

const FOLLOW_MS = 1000;
/** After so long a frame that was asked for is late. */
const LATE_MS = 200;
/** After it had to wait, playing goes on when so much is there. */
const ENOUGH_SECONDS = 1;

/** Where to begin: set before the header has come. */
export type Start = { readonly seconds: number } | { readonly frame: number };

/** What draws a stream: the element's pictures, or a scene of somebody else's. */
export interface Drawing {
  begin(layout: TextureLayout, header: StreamHeader): void;
  exactlyDrawn(answer: ExactAnswer): void;
  /** Whether the kernel draws, and has not drawn anything yet. */
  readonly awaitsKernel: boolean;
  /** Whether the kernel is the one that draws. */
  readonly exact: boolean;
  readonly stage: {
    begin(): void;
    load(update: SceneUpdate | null, draw: DrawOrder): void;
    order(draw: DrawOrder): void;
  };
}

export interface SessionHost {
  readonly tell: (name: PlayerEvent) => void;
  readonly wake: () => void;
  readonly loading: (on: boolean) => void;
  /** People are to see that something is waited for, and how much of it is there, from 0 to 1, where that is known. */
  readonly busy: (on: boolean, share: number | null) => void;
  /** Opens the stream anew. */
  readonly reopen: () => void;
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
  /** Frames whose bytes are there, from one up to, not including, another. */
  buffered: readonly Span[] = [];
  /** Whether playing waits for a frame that is late. */
  waiting = false;
  /** Where the next stream begins, as with <video>. */
  start: Start | null = null;
  readonly playback = new Playback();
  readonly sound = new LateSound(
    (message) => {
      this.send(message);
    },
    (text) => {
      this.notice(text);
    },
  );
  #connection: Connection | null = null;
  #pictures: Drawing | null = null;
  #follow = false;
  #requested = -1;
  #requests = 0;
  #seekRequest = -1;
  /** A frame asked for that is not known yet; -1 for none. */
  #seekLater = -1;
  /** The frame that stands for the stream until somebody plays it or goes elsewhere; -1: none does. */
  #standIn = -1;
  #followTimer = 0;
  #lateTimer = 0;
  #busy = false;
  /** Why nothing comes from the network; null when nothing is wrong. */
  #trouble: string | null = null;
  /** Whether time runs: false while a picture, or one that was sought, is still to come. */
  #running = false;
  #notice: string | null = null;
  /** Why WebGL2 draws where the kernel was to; null where nothing is amiss. */
  #instead: string | null = null;
  /** Until playing has begun. */
  readonly #beginnings = new Answers<undefined>();
  /** Pictures of keyframes. */
  readonly #stills = new Answers<ExactPicture | null>();
  /** The frame as a .ply. */
  readonly #plys = new Answers<Uint8Array<ArrayBuffer>>();
  /** Is aborted when the worker that is to answer is gone. */
  #lost = AbortSignal.abort(new Error("no stream is open"));
  #lose: (reason: Error) => void = () => undefined;

  constructor(private readonly host: SessionHost) {}

  open(opening: Omit<Opening, "first">, pictures: Drawing): void {
    this.#pictures = pictures;
    this.#follow = opening.follow;
    this.host.loading(true);
    this.host.tell("loadstart");
    const { start } = this;
    const first = start === null ? 0 : "frame" in start ? start.frame : null;
    this.#requested = first ?? -1;
    const controller = new AbortController();
    this.#lost = controller.signal;
    this.#lose = (reason) => {
      controller.abort(reason);
      pictures.exactlyDrawn(NO_ANSWER);
      this.#stills.refuseAll(reason);
      this.#plys.refuseAll(reason);
    };
    const died = (message: string): void => {
      this.#die(message);
    };
    try {
      this.#connection = new Connection({ ...opening, first }, (message) => {
        this.#receive(message);
      }, died);
    } catch (error) {
      died(error instanceof Error ? error.message : String(error));
    }
  }

  close(): void {
    clearTimeout(this.#followTimer);
    clearTimeout(this.#lateTimer);
    // Who was told to play before there was a stream plays the first one.
    const playing = this.#connection === null && this.playback.playing;
    this.#connection?.close();
    this.#connection = null;
    this.sound.close();
    const gone = new DOMException("another stream was opened, or the player has left the page", "AbortError");
    this.#lose(gone);
    if (!playing) this.#beginnings.refuseAll(gone);
    const emptied = this.header !== null;
    this.header = this.info = this.error = this.#notice = this.#trouble = this.#instead = null;
    this.waiting = false;
    this.buffered = [];
    this.#setBusy(false);
    this.warn();
    this.frames = new FrameColumns();
    this.#requested = this.#seekRequest = this.#seekLater = this.#standIn = -1;
    this.bytesRead = 0;
    Object.assign(this.playback, { playing, ended: false, position: 0, frameCount: 0, complete: false });
    if (emptied) this.host.tell("emptied");
  }

  /** The frame that is due, and parts of the next: that which was sought, even before anybody knows whether it is there. */
  get position(): number {
    if (this.start !== null) return "frame" in this.start ? this.start.frame : this.start.seconds * this.playback.fps;
    return this.#seekLater >= 0 ? this.#seekLater : this.playback.position;
  }

  /** Whether a frame that was sought is still to come. */
  get seeking(): boolean {
    return this.#seekRequest >= 0;
  }

  /** Aborted where nobody answers any more: no stream is open, or its worker has died. */
  get lost(): AbortSignal {
    return this.#lost;
  }

  send(message: ToWorker): void {
    this.#connection?.send(message);
  }

  /** Goes on by some seconds, and asks for the frame that is due. */
  advance(seconds: number): void {
    const { playback } = this;
    const wasPlaying = playback.playing;
    if (this.waiting && this.#enough()) this.#goOn();
    const wasRunning = this.#running;
    this.#running = playback.playing && !this.waiting && this.info !== null && !this.seeking;
    // Time begins with the picture, not with what was waited before; where there is sound, it is that of the sound.
    if (this.#running && wasRunning) playback.advance(this.sound.elapsed() ?? seconds, this.info!.frame);
    if (this.#running && playback.playing) this.sound.keep(playback);
    else this.sound.rest();
    const standsIn = this.#standsIn;
    const shown = standsIn ?? playback.due;
    if (playback.frameCount > 0 && shown !== this.#requested) this.#request(shown, standsIn === null);
    if (!wasPlaying || !playback.ended) return;
    this.host.tell("pause");
    this.host.tell("ended");
  }

  /** Resolves once playing has begun; rejects, as that of <video>, with what is wrong. After an error it is tried again. */
  play(): Promise<void> {
    const { playback } = this;
    if (this.error !== null) this.#again();
    if (this.error !== null) return Promise.reject(new DOMException(this.error, "NotSupportedError"));
    if (!playback.playing) {
      if (this.#standIn >= 0 || playback.ended || (playback.complete && playback.due >= playback.frameCount - 1)) this.seek(0);
      playback.playing = true;
      this.sound.begin();
      this.host.tell("play");
      this.host.wake();
      if (this.#begun) this.host.tell("playing");
    }
    if (this.#begun) return Promise.resolve();
    return this.#beginnings.next();
  }

  /** A picture of the keyframe at or before a frame; null where there is none. */
  still(frame: number, camera: PinholeCamera): Promise<ExactPicture | null> {
    return this.#ask(this.#stills, { type: "still", frame, camera });
  }

  /** The frame in the picture as a .ply of 3D Gaussians. */
  ply(): Promise<Uint8Array<ArrayBuffer>> {
    return this.#ask(this.#plys, { type: "ply" });
  }

  pause(): void {
    this.waiting = false;
    this.#beginnings.refuseAll(new DOMException("playing was ended before it began", "AbortError"));
    if (!this.playback.playing) return;
    this.playback.playing = false;
    this.sound.rest();
    this.host.tell("pause");
  }

  /** Goes to a frame, counted in frames and parts of them. */
  seek(frame: number): void {
    const { playback } = this;
    if (this.header === null || !Number.isFinite(frame)) return;
    this.#seekLater = frame >= playback.frameCount && !playback.complete ? frame : -1;
    playback.position = Math.max(0, Math.min(frame, playback.complete ? playback.frameCount : playback.frameCount - 1));
    playback.ended = false;
    this.#standIn = -1;
    if (this.#lost.aborted) {
      // Nobody shows the frame: playing begins there with another worker.
      this.host.tell("timeupdate");
      return;
    }
    this.host.tell("seeking");
    this.#seekRequest = this.#requests + 1;
    this.#request(playback.due);
    this.host.wake();
  }

  fail(message: string): void {
    this.error = message;
    clearTimeout(this.#lateTimer);
    this.host.loading(false);
    this.#setBusy(false);
    this.warn();
    this.#beginnings.refuseAll(new DOMException(message, "NotSupportedError"));
    this.pause();
    this.host.tell("error");
  }

  /** Says something of the stream until the worker says something else. */
  notice(text: string | null): void {
    this.#notice = text;
    this.warn();
  }

  warn(): void {
    this.host.warn(this.error ?? this.#trouble ?? this.info?.damage ?? this.#notice ?? this.#instead);
  }

  #receive(message: FromWorker): void {
    switch (message.type) {
      case "opened":
        this.#opened(message);
        break;
      case "progress":
        this.#progressed(message);
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
        this.#exactlyDrawn(message);
        break;
      case "still":
        this.#stills.answer(message.picture);
        break;
      case "ply":
        if (message.bytes === null) this.#plys.refuse(new Error(message.problem));
        else this.#plys.answer(message.bytes);
        break;
      case "sound":
        this.sound.receive(message);
        break;
      case "notYet":
        this.#requested = -1;
        clearTimeout(this.#lateTimer);
        break;
      case "refreshed":
        this.#followSoon();
        break;
      case "failed":
        this.fail(message.message);
    }
    this.host.wake();
  }

  #opened({ header: stored, layout, frames, complete }: Extract<FromWorker, { type: "opened" }>): void {
    const { stage } = this.#pictures!;
    const header = (this.header = inItsWorld(stored));
    this.frames.append(frames);
    this.playback.fps = header.fps ?? DEFAULT_FPS;
    this.#pictures!.begin(layout, header);
    this.host.opened(header);
    this.sound.open(header);
    stage.begin();
    const { start } = this;
    this.start = null;
    if (start === null && !this.host.autoplay()) this.#standIn = header.presentation.poster ?? -1;
    this.#grown(complete);
    if (start !== null) this.seek("frame" in start ? start.frame : start.seconds * this.playback.fps);
    this.host.tell("loadedmetadata");
    if (this.host.autoplay()) this.play().catch(() => undefined); // the notice says it
    this.#followSoon();
  }

  #progressed(message: Extract<FromWorker, { type: "progress" }>): void {
    const { bytesRead, buffered, complete, share, trouble } = message;
    Object.assign(this, { bytesRead, buffered });
    if (message.frames !== null) this.frames.append(message.frames);
    for (const [frame, psnr] of message.psnr) this.frames.psnr.set(frame, psnr);
    this.#grown(complete);
    const stalled = this.#trouble === null && trouble !== null;
    this.#trouble = trouble === null ? null : `Trying again: ${trouble}`;
    this.notice(message.notices.at(-1) ?? null);
    if (this.#busy || this.info === null) this.host.busy(true, share);
    this.host.tell("progress");
    if (stalled) this.host.tell("stalled");
    if (complete && this.frames.count === 0 && this.error === null) {
      this.fail(message.notices.at(-1) ?? "the stream holds no frame");
    }
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
    this.error = null;
    if (info.frame === this.#requested || message.request >= this.#requests) clearTimeout(this.#lateTimer);
    if (!this.waiting) this.#setBusy(false);
    this.#pictures!.stage.load(update, draw);
    this.#sorted(draw);
    this.#recycle(draw.order, update?.base, update?.rest, update?.heat, update?.part?.places);
    this.warn();
    if (first) {
      this.host.loading(false);
      this.host.tell("loadeddata");
      this.host.tell("canplay");
    }
    if (this.#beginnings.awaited) this.#begin();
    else if (first && this.playback.playing) this.host.tell("playing");
    this.host.tell("timeupdate");
    if (this.#seekLater < 0 && this.#seekRequest >= 0 && message.request >= this.#seekRequest) {
      this.#seekRequest = -1;
      this.host.tell("seeked");
    }
  }

  /** Where the kernel gives no picture, WebGL2 draws instead, which is said; without WebGL2, nothing does. */
  #exactlyDrawn(answer: ExactAnswer): void {
    const { picture, problem, kernel } = answer;
    const pictures = this.#pictures!;
    const { exact: wanted } = pictures; // or WebGL2 was chosen meanwhile
    pictures.exactlyDrawn(answer);
    if (picture !== null) this.#instead = null;
    if (problem !== null && wanted) {
      if (!pictures.exact) this.#instead = `WebGL2 draws: ${problem}`;
      else if (kernel && !pictures.awaitsKernel) this.#notice = problem;
      else if (this.error === null) this.fail(problem);
    }
    this.warn();
    this.#begin();
  }

  /** Playing has begun for those who wait for it, once there is something to be seen. */
  #begin(): void {
    if (!this.#begun || !this.#beginnings.awaited) return;
    this.#beginnings.answerAll(undefined);
    this.host.tell("playing");
  }

  #sorted({ count, sortMs }: { readonly count: number; readonly sortMs: number }): void {
    this.drawn = { count, sortMs };
  }

  #recycle(...arrays: (Uint32Array | Uint8Array | null | undefined)[]): void {
    const buffers = arrays.flatMap((array) => (array ? [array.buffer as ArrayBuffer] : []));
    const whole = buffers.filter((buffer) => buffer.byteLength > 0);
    this.#connection?.send({ type: "recycle", buffers: whole }, whole);
  }

  /** null before it is known that there is such a frame. */
  get #standsIn(): number | null {
    const { frameCount, complete } = this.playback;
    return this.#standIn >= 0 && (complete || frameCount > this.#standIn) ? Math.min(this.#standIn, frameCount - 1) : null;
  }

  get #begun(): boolean {
    return this.info !== null && this.error === null && this.#pictures?.awaitsKernel !== true;
  }

  /** What failed is asked for once more. */
  #again(): void {
    this.error = null;
    this.warn();
    if (!this.#lost.aborted && this.frames.count > 0) this.#request(this.playback.due);
    else {
      if (this.frames.count > 0) this.start ??= { frame: this.#seekLater >= 0 ? this.#seekLater : this.playback.due };
      this.host.reopen();
    }
  }

  #ask<T>(answers: Answers<T>, question: ToWorker): Promise<T> {
    if (this.#lost.aborted) return Promise.reject(this.#lost.reason as Error);
    this.send(question);
    return answers.next();
  }

  /** The worker is gone: nothing that it was asked for comes. */
  #die(message: string): void {
    this.#connection?.close();
    this.#connection = null;
    this.#seekRequest = -1;
    this.#lose(new Error(message));
    this.fail(message);
    this.host.wake();
  }

  #late(): void {
    this.#setBusy(true);
    if (!this.playback.playing || this.waiting) return;
    this.waiting = true;
    this.host.tell("waiting");
  }

  #goOn(): void {
    this.waiting = false;
    this.#setBusy(false);
    if (this.playback.playing) this.host.tell("playing");
  }

  /** Whether so much is there that playing will not have to wait again at once. */
  #enough(): boolean {
    const { due, fps, frameCount, rate } = this.playback;
    if (this.info?.frame !== due) return false;
    const until = Math.min(frameCount, Math.ceil(due + ENOUGH_SECONDS * fps * rate));
    return this.buffered.some(([from, to]) => from <= due && to >= until);
  }

  #setBusy(on: boolean): void {
    this.#busy = on;
    this.host.busy(on, null);
  }

  /** `asked`: somebody plays or seeks; otherwise the worker need not read on. */
  #request(frame: number, asked = true): void {
    this.#requested = frame;
    clearTimeout(this.#lateTimer);
    this.#lateTimer = window.setTimeout(() => {
      this.#late();
    }, LATE_MS);
    if (asked) this.#requests++;
    this.send({ type: "show", frame, request: this.#requests });
  }

  #followSoon(): void {
    clearTimeout(this.#followTimer);
    if (this.playback.complete || !this.#follow) return;
    this.#followTimer = window.setTimeout(() => {
      this.send({ type: "refresh" });
    }, FOLLOW_MS);
  }
}
