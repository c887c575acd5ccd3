/** One stream's life: what the worker says of it, which frame is due, seeking, and following a file that grows. */
import type { PinholeCamera } from "../geometry/camera";
import { inItsWorld } from "../geometry/world";
import { NO_ANSWER, type ExactAnswer, type ExactPicture, type FrameInfo, type FromWorker, type Opening, type ToWorker } from "../messages";
import type { StreamHeader } from "../scene";
import { Answers } from "./answers";
import { Buffering } from "./buffering";
import { Connection, FrameColumns } from "./connection";
import { Faults } from "./faults";
import { Following } from "./following";
import type { Span } from "../player_api";
import { DEFAULT_FPS, Playback, framesOf, type Moment } from "./playback";
import { Questions } from "./questions";
import type { Drawing, SessionHost } from "./session_host";
import { LateSound } from "../sound/late";

export class Session {
  header: StreamHeader | null = null;
  /** Of the frame in the picture. */
  info: FrameInfo | null = null;
  frames = new FrameColumns();
  bytesRead = 0;
  drawn = { count: 0, sortMs: 0 };
  /** Frames whose bytes are there, from one up to, not including, another. */
  buffered: readonly Span[] = [];
  refined: readonly Span[] = [];
  /** Where the next stream begins, as with <video>. */
  start: Moment | null = null;
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
  #follows = false;
  #requested = -1;
  #requests = 0;
  #seekRequest = -1;
  /** A frame asked for that is not known yet; -1 for none. */
  #seekLater = -1;
  /** The frame that stands for the stream until somebody plays it or goes elsewhere; -1: none does. */
  #standIn = -1;
  /** Whether time runs: false while a picture, or one that was sought, is still to come. */
  #running = false;
  /** Until playing has begun. */
  readonly #beginnings = new Answers<undefined>();
  readonly #questions = new Questions((message) => {
    this.send(message);
  });
  readonly #following = new Following(() => {
    this.send({ type: "refresh" });
  });
  readonly #buffering: Buffering;
  readonly #faults: Faults;

  constructor(private readonly host: SessionHost) {
    this.#buffering = new Buffering(this.playback, host);
    this.#faults = new Faults(host.warn);
  }

  open(opening: Omit<Opening, "first">, pictures: Drawing): void {
    this.#pictures = pictures;
    this.#follows = opening.follow;
    this.host.loading(true);
    this.host.tell("loadstart");
    const { start } = this;
    const first = start === null ? 0 : "frame" in start ? start.frame : null;
    this.#requested = first ?? -1;
    this.#questions.begin();
    try {
      this.#connection = new Connection({ ...opening, first }, this.#receive, this.#die);
    } catch (error) {
      this.#die(error instanceof Error ? error.message : String(error));
    }
  }

  close(): void {
    this.#following.end();
    // Who was told to play before there was a stream plays the first one.
    const playing = this.#connection === null && this.playback.playing;
    this.#connection?.close();
    this.#connection = null;
    this.sound.close();
    const gone = new DOMException("another stream was opened, or the player has left the page", "AbortError");
    this.#lose(gone);
    if (!playing) this.#beginnings.refuseAll(gone);
    const emptied = this.header !== null;
    this.header = this.info = null;
    this.buffered = this.refined = [];
    this.#buffering.end();
    this.#faults.forget();
    this.#faults.say();
    this.frames = new FrameColumns();
    this.#requested = this.#seekRequest = this.#seekLater = this.#standIn = -1;
    this.bytesRead = 0;
    Object.assign(this.playback, { playing, ended: false, position: 0, frameCount: 0, complete: false });
    if (emptied) this.host.tell("emptied");
  }

  /** What went wrong, a sentence; null when nothing. */
  get error(): string | null {
    return this.#faults.error;
  }

  /** The frame that is due, and parts of the next: that which was sought, even before anybody knows whether it is there. */
  get position(): number {
    if (this.start !== null) return framesOf(this.start, this.playback.fps);
    return this.#seekLater >= 0 ? this.#seekLater : this.playback.position;
  }

  /** Whether a frame that was sought is still to come. */
  get seeking(): boolean {
    return this.#seekRequest >= 0;
  }

  /** Whether playing waits for a frame that is late. */
  get waiting(): boolean {
    return this.#buffering.waiting;
  }

  /** Aborted where nobody answers any more: no stream is open, or its worker has died. */
  get lost(): AbortSignal {
    return this.#questions.lost;
  }

  send(message: ToWorker): void {
    this.#connection?.send(message);
  }

  /** Goes on by some seconds, and asks for the frame that is due. */
  advance(seconds: number): void {
    const { playback } = this;
    const wasPlaying = playback.playing;
    this.#buffering.goOn(this.buffered, this.info?.frame);
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
    return this.#questions.still(frame, camera);
  }

  /** The frame in the picture as a .ply of 3D Gaussians. */
  ply(): Promise<Uint8Array<ArrayBuffer>> {
    return this.#questions.ply();
  }

  pause(): void {
    this.#buffering.waiting = false;
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
    if (this.lost.aborted) {
      // Nobody shows the frame: playing begins there with another worker.
      this.host.tell("timeupdate");
      return;
    }
    this.host.tell("seeking");
    this.#seekRequest = this.#requests + 1;
    this.#request(playback.due);
    this.host.wake();
  }

  /** Seeks, or has the next stream begin there where its header has not come. */
  goTo(moment: Moment): void {
    const frame = framesOf(moment, this.playback.fps);
    if (this.header !== null) this.seek(frame);
    else if (Number.isFinite(frame)) this.start = frame < 0 ? { frame: 0 } : moment;
  }

  fail(message: string): void {
    this.#faults.error = message;
    this.host.loading(false);
    this.#buffering.end();
    this.#faults.say();
    this.#beginnings.refuseAll(new DOMException(message, "NotSupportedError"));
    this.pause();
    this.host.tell("error");
  }

  /** Says something of the stream until the worker says something else. */
  notice(text: string | null): void {
    this.#faults.notice = text;
    this.#faults.say();
  }

  readonly #receive = (message: FromWorker): void => {
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
        this.drawn = { count: message.draw.count, sortMs: message.draw.sortMs };
        this.#connection?.recycle(message.draw.order);
        break;
      case "exact":
        this.#exactlyDrawn(message);
        break;
      case "still":
      case "ply":
        this.#questions.receive(message);
        break;
      case "sound":
        this.sound.receive(message);
        break;
      case "notYet":
        this.#requested = -1;
        this.#buffering.expectNone();
        break;
      case "refreshed":
        this.#follow();
        break;
      case "failed":
        this.fail(message.message);
    }
    this.host.wake();
  };

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
    if (start !== null) this.goTo(start);
    this.host.tell("loadedmetadata");
    if (this.host.autoplay()) this.play().catch(() => undefined); // the notice says it
    this.#follow();
  }

  #progressed(message: Extract<FromWorker, { type: "progress" }>): void {
    const { bytesRead, buffered, refined, complete, share, trouble } = message;
    Object.assign(this, { bytesRead, buffered, refined });
    if (message.frames !== null) this.frames.append(message.frames);
    for (const [frame, psnr] of message.psnr) this.frames.psnr.set(frame, psnr);
    this.#grown(complete);
    const stalled = this.#faults.trouble === null && trouble !== null;
    this.#faults.trouble = trouble === null ? null : `Trying again: ${trouble}`;
    this.notice(message.notices.at(-1) ?? null);
    this.#buffering.progress(share, this.info === null);
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
    const layered = !first && info.layer !== this.info!.layer;
    this.info = info;
    if (layered) this.host.tell("layerchange");
    this.#faults.damage = info.damage;
    this.#faults.error = null;
    if (info.frame === this.#requested || message.request >= this.#requests) this.#buffering.expectNone();
    this.#buffering.shown();
    this.#pictures!.stage.load(update, draw);
    this.drawn = { count: draw.count, sortMs: draw.sortMs };
    this.#connection?.recycle(draw.order, update?.base, update?.rest, update?.heat, update?.part?.slots);
    this.#faults.say();
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

  #exactlyDrawn(answer: ExactAnswer): void {
    const problem = this.#faults.exactlyDrawn(answer, this.#pictures!);
    if (problem !== null && this.error === null) this.fail(problem);
    this.#faults.say();
    this.#begin();
  }

  /** Playing has begun for those who wait for it, once there is something to be seen. */
  #begin(): void {
    if (!this.#begun || !this.#beginnings.awaited) return;
    this.#beginnings.answerAll(undefined);
    this.host.tell("playing");
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
    this.#faults.error = null;
    this.#faults.say();
    if (!this.lost.aborted && this.frames.count > 0) this.#request(this.playback.due);
    else {
      if (this.frames.count > 0) this.start ??= { frame: this.#seekLater >= 0 ? this.#seekLater : this.playback.due };
      this.host.reopen();
    }
  }

  /** The worker is gone: nothing that it was asked for comes. */
  readonly #die = (message: string): void => {
    this.#connection?.close();
    this.#connection = null;
    this.#seekRequest = -1;
    this.#lose(new Error(message));
    this.fail(message);
    this.host.wake();
  };

  #lose(reason: Error): void {
    this.#questions.lose(reason);
    this.#pictures?.exactlyDrawn(NO_ANSWER);
  }

  /** `asked`: somebody plays or seeks; otherwise the worker need not read on. */
  #request(frame: number, asked = true): void {
    this.#requested = frame;
    this.#buffering.expect();
    if (asked) this.#requests++;
    this.send({ type: "show", frame, request: this.#requests });
  }

  #follow(): void {
    if (this.#follows && !this.playback.complete) this.#following.goOn();
  }
}
