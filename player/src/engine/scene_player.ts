/** A stream that plays in a scene of an engine: time, frames and bytes as those of <video>, without an element. */
import { upOf } from "../camera/up_direction";
import type { PlayerEvent } from "../element/events";
import { Session } from "../element/session";
import type { Vector } from "../geometry/vectors";
import type { FrameInfo } from "../messages";
import type { StreamHeader } from "../scene";
import type { EngineView } from "./engine_view";
import { SceneDrawing } from "./scene_drawing";

const LONGEST_STEP = 0.1;

export interface SceneOptions {
  readonly autoplay?: boolean;
  readonly loop?: boolean;
  /** The stream is still being written. */
  readonly follow?: boolean;
}

/** Sends the events of the element, of type `PlayerEvent`, that are not about views. */
export class ScenePlayer extends EventTarget {
  readonly #drawing: SceneDrawing;
  readonly #session: Session;
  #waking = false;
  /** Why a view was not drawn; null once one is. */
  #refused: string | null = null;
  readonly #reported = new Set<string>();
  #lastTime = 0;

  constructor(source: string, { autoplay = false, loop = false, follow = false }: SceneOptions = {}) {
    super();
    this.#drawing = new SceneDrawing(
      (depth, serial) => {
        this.#session.send({ type: "view", depth, serial });
      },
      () => {
        this.#session.send({ type: "resend" });
      },
      (pose) => {
        this.#session.sound.listen(pose);
      },
    );
    const nothing = (): void => undefined;
    this.#session = new Session({
      tell: (name) => {
        this.#tell(name);
      },
      wake: () => {
        this.#wake();
      },
      loading: nothing,
      busy: nothing,
      reopen: () => {
        this.#open(source, follow);
      },
      warn: nothing,
      opened: nothing,
      autoplay: () => autoplay,
    });
    this.#session.playback.loop = loop;
    this.#open(source, follow);
  }

  /** What is known of the stream, its cameras in its world; null before `loadedmetadata`. */
  get header(): StreamHeader | null {
    return this.#session.header;
  }
  /** Of the frame that is shown. */
  get info(): FrameInfo | null {
    return this.#session.info;
  }
  /** What went wrong, a sentence; null when nothing. */
  get error(): string | null {
    return this.#session.error ?? this.#refused;
  }
  /** Which way is up in the stream's world, as its cameras tell it; null before `loadedmetadata`. */
  get up(): Vector | null {
    return this.header === null ? null : upOf(this.header.cameras);
  }
  get paused(): boolean {
    return !this.#session.playback.playing;
  }
  get ended(): boolean {
    return this.#session.playback.ended;
  }
  get frameCount(): number {
    return this.#session.playback.frameCount;
  }
  get fps(): number {
    return this.#session.playback.fps;
  }
  get duration(): number {
    return this.header === null ? NaN : this.frameCount / this.fps;
  }
  get currentFrame(): number {
    return this.#session.playback.due;
  }
  set currentFrame(frame: number) {
    this.#session.goTo({ frame: Math.round(frame) });
  }
  get currentTime(): number {
    return this.#session.position / this.fps;
  }
  set currentTime(seconds: number) {
    this.#session.goTo({ seconds });
  }
  get loop(): boolean {
    return this.#session.playback.loop;
  }
  set loop(value: boolean) {
    this.#session.playback.loop = value;
  }
  get playbackRate(): number {
    return this.#session.playback.rate;
  }
  set playbackRate(rate: number) {
    this.#session.playback.rate = rate;
    this.#tell("ratechange");
  }

  /** Of a stream that has sound, from 0 to 1. */
  get volume(): number {
    return this.#session.sound.volume;
  }
  set volume(value: number) {
    this.#session.sound.volume = value;
    this.#tell("volumechange");
  }
  get muted(): boolean {
    return this.#session.sound.muted;
  }
  set muted(value: boolean) {
    this.#session.sound.muted = value;
    this.#tell("volumechange");
  }

  /** Resolves once playing has begun; rejects with what is wrong. After an error it tries again. */
  play(): Promise<void> {
    if (this.paused) this.#lastTime = performance.now(); // what has passed since the last picture does not count
    return this.#session.play();
  }

  pause(): void {
    this.#session.pause();
  }

  /** Draws the frame that is due into the target that the engine has bound, which holds its opaque objects. Whether it did. */
  draw(gl: WebGL2RenderingContext, view: EngineView): boolean {
    this.#advance();
    try {
      if (!this.#drawing.draw(gl, view)) return false;
    } catch (error) {
      this.refuse(error instanceof Error ? error.message : String(error));
      return false;
    }
    this.#refused = null;
    return true;
  }

  /** Says why nothing is drawn: as `error`, and once as an event and in the console. */
  refuse(why: string): void {
    this.#refused = why;
    if (this.#reported.has(why)) return;
    this.#reported.add(why);
    console.error(why);
    this.#tell("error");
  }

  /** Gives worker and textures back. */
  dispose(): void {
    this.#session.close();
    this.#drawing.dispose();
  }

  #open(source: string, follow: boolean): void {
    this.#session.close();
    this.#session.open({ source: new URL(source, document.baseURI).href, follow }, this.#drawing);
  }

  /** Time runs by the clock while pictures are drawn. */
  #advance(): void {
    const now = performance.now();
    const seconds = Math.min(LONGEST_STEP, Math.max(0, (now - this.#lastTime) / 1000));
    this.#lastTime = now;
    this.#session.advance(seconds);
  }

  /** Frames are asked for whether the engine draws at the moment or not. */
  #wake(): void {
    if (this.#waking) return;
    this.#waking = true;
    queueMicrotask(() => {
      this.#waking = false;
      this.#session.advance(0);
    });
  }

  #tell(name: PlayerEvent): void {
    this.dispatchEvent(new Event(name));
  }
}
