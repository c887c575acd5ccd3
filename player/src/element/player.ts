/**
 * `<decogs-player src="scene.dgs" controls>`: plays a stream, with the manners of <video>.
 *
 * Attributes: src, controls, autoplay, loop, poster, preload, crossorigin, camera (a name), follow (the stream is still being written),
 * exact (drawn by the decoder's own kernel; "off": by WebGL2 wherever there is any; without it, by what is faster), recorded (cameras of the rig show
 * what they recorded: with lens and colours), background (the colour behind a subject; without it, the page shows there),
 * quality (a share of the pixels, and fewer Gaussians, for weak devices), range (frames A:B that are played again and again, B not among them), orbit (the view moves by itself until somebody takes it), limits ("rig": views stay where cameras have seen the scene from),
 * muted (without sound, to begin with), gestures ("cooperative": one finger and the wheel scroll the page, two fingers and Ctrl move the camera).
 * The worker decodes and sorts, the stage draws, the panels are for people; this holds them together.
 */
import { startRecorded } from "../draw/recorded";
import type { Lens, PinholeCamera } from "../geometry/camera";
import type { Pose } from "../geometry/poses";
import { intoScene } from "../geometry/similarity";
import type { Vector } from "../geometry/vectors";
import { NO_ANSWER, type FrameInfo } from "../messages";
import { OVERLAYS, type Figures, type FrameList, type Overlay, type Place, type PlayerApi, type Span, type View } from "../player_api";
import type { StreamHeader } from "../scene";
import type { PlayerEvent } from "./events";
import { adopt, adoptAgain } from "../adopted_style";
import { AttributeElement, takeOverProperties } from "./attributes";
import { FrameCallbacks } from "./frame_callbacks";
import { Headset } from "./headset";
import { LateControls } from "./late_controls";
import { PixelRatio } from "./pixel_ratio";
import { Pictures, type ExactChoice, type PicturesHost } from "./pictures";
import { Poster } from "./poster";
import { Ranges } from "./ranges";
import { Session } from "./session";
import { Sight } from "./sight";
import style from "./style.css";
import { Viewpoint } from "./viewpoint";

const LONGEST_STEP = 0.1;

/** What an element that left the page takes up again. */
interface Left {
  readonly source: string;
  readonly frame: number;
  readonly camera: string;
  readonly view: View | null;
}

/** What screen readers say until a stream has told its title. */
const UNNAMED = "Free-viewpoint video";

/** Where the project's own tests look inside; nothing of it is promised to anybody. */
const INSIDE = Symbol.for("decogs.inside");

export class DecogsPlayer extends AttributeElement implements PlayerApi {
  static readonly observedAttributes = ["src", "crossorigin", "preload", "controls", "autoplay", "loop", "poster", "camera", "exact", "recorded", "background", "orbit", "limits", "range", "quality", "muted"];

  readonly #root = this.attachShadow({ mode: "open" });
  readonly #poster = new Poster();
  readonly #frameCallbacks = new FrameCallbacks();
  readonly #late = new LateControls(this, this.#root);
  readonly #session = new Session({
    tell: (name) => {
      this.#tell(name);
    },
    wake: () => {
      this.#wake();
    },
    loading: (on) => {
      this.#late.setLoading(on);
    },
    busy: (on, share) => {
      this.#late.setBusy(on, share);
    },
    reopen: () => {
      this.#open();
      if (this.#deferred) this.#begin(); // who plays has it come
    },
    warn: (text) => {
      this.#late.warn(text);
    },
    opened: (header) => {
      this.#opened(header);
    },
    autoplay: () => this.autoplay && !this.#waitsToBeSeen(),
  });
  readonly #headset = new Headset(
    this.#session,
    () => {
      this.#pictures?.chooseExact(this.#exactChoice);
      this.#tell("xrend");
      this.#wake();
    },
    () => {
      if (this.paused) this.play().catch(() => undefined);
      else this.pause();
    },
  );
  #pictures: Pictures | null = null;
  readonly #viewpoint = new Viewpoint({
    navigation: () => this.#pictures?.stage.navigation ?? null,
    moved: () => {
      this.#pictures?.stage.touch();
      this.#tell("camerachange");
      this.#wake();
    },
    put: () => {
      this.#late.panels?.tellCamera();
    },
    asked: () => {
      this.#poster.giveWay();
    },
  });
  #overlay: Overlay = "none";
  /** The address of the stream that is open or was open last. */
  #source = "";
  /** Where it stood when the element left the page. */
  #left: Left | null = null;
  #comparing = false;
  /** The name that the page's author has not given. */
  #ownName = "";
  /** Whether the stream is opened when somebody plays it. */
  #deferred = false;
  /** Whether playing goes on once the player is seen again. */
  #pausedUnseen = false;
  #ticking = 0;
  #lastTick = 0;
  /** The document that is heard. */
  #document = document;
  readonly #resized = new ResizeObserver(() => {
    this.#touch();
  });
  readonly #ratio = new PixelRatio(() => {
    this.#touch();
  });
  readonly #sight = new Sight(() => {
    this.#sightChanged();
  });

  constructor() {
    super();
    adopt(this.#root, style);
    this.#root.append(this.#poster.image);
    for (const name of ["keydown", "keyup"] as const) {
      this.addEventListener(name, (event) => {
        this.#late.key(event);
      });
    }
    this.addEventListener("blur", () => {
      this.#late.forgetKeys();
      if (this.#viewpoint.isFlying) this.#viewpoint.fly([0, 0, 0]);
    });
  }

  connectedCallback(): void {
    takeOverProperties(this);
    if (!this.hasAttribute("tabindex")) this.tabIndex = 0;
    if (!this.hasAttribute("role")) this.setAttribute("role", "region");
    if (!this.hasAttribute("aria-label")) this.#name(UNNAMED);
    this.#resized.observe(this);
    if (this.#document !== this.ownerDocument) this.#moveTo(this.ownerDocument);
    this.#ratio.begin(this.#window);
    this.#sight.begin(this);
    if (this.#pictures === null || this.#source !== this.#address) this.#open();
  }

  /** An element that is moved in the page is put in again at once: then everything goes on. */
  disconnectedCallback(): void {
    this.#resized.disconnect();
    this.#ratio.end();
    this.#sight.end();
    queueMicrotask(() => {
      if (!this.isConnected) this.#leave();
    });
  }

  adoptedCallback(): void {
    adoptAgain(this.#root);
  }

  attributeChangedCallback(name: string, before: string | null, value: string | null): void {
    if (before === value) return;
    if ((name === "src" || name === "crossorigin") && this.isConnected) this.#open();
    if (this.#deferred && !this.#defers) this.#begin();
    if (name === "loop") this.#session.playback.loop = value !== null;
    if (name === "poster") this.#poster.address = this.poster;
    if (name === "exact" && this.#pictures?.chooseExact(this.#exactChoice) === true) this.#wake();
    if (name === "recorded") void this.#chooseRecorded();
    if (name === "background") this.#pictures?.layBehind(value, this.#poster.image);
    if (name === "orbit") {
      this.#viewpoint.sway(value !== null);
      this.#wake();
    }
    if (name === "muted") this.muted = value !== null;
    if (name === "limits") this.#viewpoint.limit(value === "rig");
    if (name === "quality") this.#chooseQuality();
    if (name === "range") this.#session.playback.range = this.range;
    if (name === "camera" && value !== null) this.camera = value;
    this.#late.panels?.refresh();
  }

  /** The address of the stream that is open. */
  get currentSrc(): string {
    return this.#source;
  }
  get volume(): number {
    return this.#session.sound.volume;
  }
  set volume(value: number) {
    this.#session.sound.volume = value;
    this.#volumeChanged();
  }
  get muted(): boolean {
    return this.#session.sound.muted;
  }
  set muted(value: boolean) {
    this.#session.sound.muted = value;
    this.#volumeChanged();
  }

  get header(): StreamHeader | null {
    return this.#session.header;
  }
  get info(): FrameInfo | null {
    return this.#session.info;
  }
  get frames(): FrameList {
    return this.#session.frames;
  }
  /** What went wrong, a sentence; null when nothing. */
  get error(): string | null {
    return this.#session.error;
  }
  get bufferedFrames(): readonly Span[] {
    return this.#session.buffered;
  }
  /** Seconds that can be played without the network, as with <video>. */
  get buffered(): Ranges {
    return new Ranges(this.bufferedFrames.map(([from, to]) => [from / this.fps, to / this.fps]));
  }
  get seekable(): Ranges {
    return new Ranges(this.duration > 0 ? [[0, this.duration]] : []);
  }
  get seeking(): boolean {
    return this.#session.seeking;
  }
  /** As with <video>: 0 nothing, 1 the header, 2 a frame, 3 the next one as well, 4 all that follow. */
  get readyState(): 0 | 1 | 2 | 3 | 4 {
    if (this.header === null) return 0;
    if (this.info === null) return 1;
    const { playback, waiting } = this.#session;
    const ahead = this.bufferedFrames.find(([from, to]) => from <= playback.due && to > playback.due)?.[1] ?? 0;
    if (ahead === playback.frameCount) return 4;
    return waiting || ahead <= playback.due + 1 ? 2 : 3;
  }
  /** Pixels of the picture of the camera looked through, as with <video>; 0 before `loadedmetadata`. */
  get videoWidth(): number {
    return this.view?.lens.width ?? 0;
  }
  get videoHeight(): number {
    return this.view?.lens.height ?? 0;
  }
  get paused(): boolean {
    return !this.#session.playback.playing;
  }
  get ended(): boolean {
    return this.#session.playback.ended;
  }
  get fps(): number {
    return this.#session.playback.fps;
  }
  get duration(): number {
    return this.header === null ? NaN : this.#session.playback.frameCount / this.fps;
  }
  get currentTime(): number {
    return this.#session.position / this.fps;
  }
  set currentTime(seconds: number) {
    if (this.header !== null) this.#session.seek(seconds * this.fps);
    else if (Number.isFinite(seconds)) this.#session.start = { seconds: Math.max(0, seconds) };
  }
  get currentFrame(): number {
    const { position, playback } = this.#session;
    return position === playback.position ? playback.due : Math.floor(position + 1e-6);
  }
  set currentFrame(frame: number) {
    if (this.header !== null) this.#session.seek(Math.round(frame));
    else if (Number.isFinite(frame)) this.#session.start = { frame: Math.max(0, Math.round(frame)) };
  }
  get playbackRate(): number {
    return this.#session.playback.rate;
  }
  set playbackRate(rate: number) {
    this.#session.playback.rate = rate;
    this.#tell("ratechange");
  }

  get overlay(): Overlay {
    return this.#overlay;
  }
  set overlay(overlay: Overlay) {
    if (!OVERLAYS.includes(overlay)) throw new RangeError(`overlay must be one of ${OVERLAYS.join(", ")}`);
    this.#overlay = overlay;
    if (this.#pictures === null) return;
    this.#pictures.overlay = overlay;
    this.#touch();
  }
  get exact(): boolean {
    return this.#pictures?.exact ?? false;
  }
  set exact(value: boolean) {
    this.setAttribute("exact", value ? "" : "off");
  }
  get #exactChoice(): ExactChoice {
    const value = this.getAttribute("exact");
    return value === null ? null : value !== "off";
  }
  get canChooseExact(): boolean {
    return this.#pictures?.canChooseExact ?? false;
  }
  get comparing(): boolean {
    return this.#comparing;
  }
  set comparing(value: boolean) {
    this.#comparing = value && this.hasAttribute("recordings");
    if (this.#comparing) this.recorded = true;
    this.#late.panels?.refresh();
    this.#wake();
  }
  get camera(): string {
    return this.#viewpoint.camera?.name ?? "";
  }
  set camera(name: string) {
    this.#viewpoint.lookAt(name);
  }
  get view(): View | null {
    return this.#viewpoint.view;
  }
  get figures(): Figures | null {
    if (this.#pictures === null || this.info === null) return null;
    const { renderer, drawnAt } = this.#pictures.stage;
    const { width, height } = renderer.canvas;
    const { drawn, bytesRead } = this.#session;
    return { pictures: drawnAt.length, width, height, drawn: drawn.count, sortMs: drawn.sortMs, bytesRead, ...renderer.times };
  }

  /** Opens the stream anew, as that of <video>. */
  load(): void {
    if (this.isConnected) this.#open();
  }

  play(): Promise<void> {
    this.#pausedUnseen = false;
    if (this.#deferred) this.#begin();
    return this.#session.play();
  }

  pause(): void {
    this.#pausedUnseen = false;
    this.#session.pause();
  }

  /** Has a function called once, when the next frame has come into the picture; its number, to take it back with. */
  requestVideoFrameCallback(callback: VideoFrameRequestCallback): number {
    return this.#frameCallbacks.request(callback);
  }

  cancelVideoFrameCallback(request: number): void {
    this.#frameCallbacks.cancel(request);
  }

  currentCamera(width?: number, height?: number): PinholeCamera | null {
    const size = this.#pixels();
    return this.#pictures?.stage.camera(width ?? size.width, height ?? size.height) ?? null;
  }

  async capture(width?: number, height?: number): Promise<Blob> {
    if (this.#pictures === null || this.info === null) throw new Error("there is no picture yet");
    const size = this.#pixels();
    if (this.recorded) await startRecorded();
    const picture = await this.#pictures.stage.capture(width ?? size.width, height ?? size.height, this.#session.lost);
    this.#wake();
    return picture;
  }

  async thumbnail(frame: number, width: number): Promise<ImageData | null> {
    if (this.#pictures === null || this.info === null) return null;
    const { stage } = this.#pictures;
    const { clientWidth, clientHeight } = this;
    const camera = stage.camera(width, Math.max(1, Math.round((width * clientHeight) / Math.max(1, clientWidth))));
    const picture = await this.#session.still(frame, intoScene({ ...camera, recording: null }, stage.transform));
    return picture && new ImageData(picture.pixels, picture.width, picture.height);
  }

  async ply(): Promise<Blob> {
    if (this.info === null) throw new Error("there is no frame yet");
    return new Blob([await this.#session.ply()], { type: "application/octet-stream" });
  }

  lookThrough(index: number, atOnce = false): void {
    this.#viewpoint.lookThrough(index, atOnce);
  }

  nextCamera(step: 1 | -1): void {
    this.#viewpoint.next(step);
  }

  backToCamera(): void {
    this.#viewpoint.back();
  }

  lookFrom(pose: Pose, lens: Lens): void {
    this.#viewpoint.lookFrom(pose, lens);
  }

  async enterXr(mode: "immersive-vr" | "immersive-ar"): Promise<void> {
    if (this.#pictures === null || this.info === null) throw new Error("there is no picture yet");
    await this.#headset.enter(mode, this.#pictures);
    this.#tell("xrstart");
  }

  leaveXr(): Promise<void> {
    return this.#headset.leave();
  }

  fly(direction: Vector): void {
    this.#viewpoint.fly(direction);
  }

  recordedPlace(): Place | null {
    return this.currentCamera(this.clientWidth, this.clientHeight)?.recording ?? null;
  }

  recordingAddress(): string {
    const template = this.getAttribute("recordings");
    if (template === null || this.camera === "" || this.info === null) return "";
    const path = template.replace("{camera}", encodeURIComponent(this.camera)).replace("{frame}", String(this.info.frame));
    return new URL(path, document.baseURI).href;
  }

  get [INSIDE](): unknown {
    const { playback } = this.#session;
    return { stage: this.#pictures?.stage ?? null, playback, ticking: this.#ticking };
  }

  /** Of the document that shows the element: another one may be hidden. */
  get #window(): Window {
    return this.#document.defaultView ?? window;
  }

  /** What another window was asked for may never come: it may have been closed. */
  #moveTo(document: Document): void {
    this.#window.cancelAnimationFrame(this.#ticking);
    this.#ticking = 0;
    this.#document = document;
    this.#wake();
  }

  /** Something is to be drawn or to be waited for: ticks until it is done. */
  #wake(): void {
    if (this.#ticking === 0) this.#ticking = this.#window.requestAnimationFrame(this.#tick);
  }

  readonly #tick = (at: number): void => {
    this.#ticking = 0;
    const now = this.#window === window ? at : performance.now(); // each window counts from its own beginning
    const { playback } = this.#session;
    const seconds = Math.min(LONGEST_STEP, Math.max(0, (now - this.#lastTick) / 1000));
    this.#lastTick = now;
    const stage = this.#pictures?.stage;
    if (stage === undefined || this.#headset.entered) return;
    this.#session.advance(seconds);
    this.#session.sound.listen(stage.navigation.pose);
    // play() waits for the kernel's first picture, seen or not.
    if (!this.#sight.offScreen || (playback.playing && this.#pictures?.awaitsKernel === true)) {
      if (stage.step(now, seconds, playback.playing)) this.#drawn(now);
      this.#pictures?.judge();
    }
    this.#late.panels?.tick(now);
    const changing = stage.pending || stage.renderer.busy || this.#viewpoint.isMoving;
    if (playback.playing || (changing && !this.#sight.offScreen)) this.#wake();
  };

  #drawn(now: number): void {
    this.#poster.drawn();
    if (this.info === null) return;
    const { info, fps, videoWidth: width, videoHeight: height } = this;
    this.#frameCallbacks.drawn(info.frame, now, { width, height, fps, costMs: info.decodeMs + info.packMs });
  }

  /** What is no address stays as it was written. */
  get #address(): string {
    return this.src === "" ? "" : (absolute(this.src) ?? this.src);
  }

  #open(): void {
    this.#close();
    this.#source = this.#address;
    if (this.#source === "") {
      this.#late.start();
      return;
    }
    if (this.#left?.source === this.#source) this.#session.start ??= { frame: this.#left.frame };
    else this.#left = null;
    if (this.#defers) {
      this.#deferred = true;
      this.#late.start();
    } else this.#begin();
  }

  /** Whether nothing is to be read before somebody plays. */
  get #defers(): boolean {
    return this.preload === "none" && !this.autoplay && this.#left === null;
  }

  /** Has the stream come. */
  #begin(): void {
    this.#deferred = false;
    try {
      if (absolute(this.#source) === null) throw new Error(`${this.#source} is no address`);
      this.#pictures ??= this.#newPictures();
    } catch (error) {
      this.#session.fail(error instanceof Error ? error.message : String(error));
      return;
    }
    const opening = { source: this.#source, follow: this.hasAttribute("follow"), sparing: this.preload === "metadata" && !this.autoplay };
    this.#session.open(this.crossOrigin === "use-credentials" ? { ...opening, credentials: "include" } : opening, this.#pictures);
  }

  /** Gives everything back that an element outside of the page does not need. */
  #leave(): void {
    void this.#headset.leave();
    const { header, view, currentFrame: frame, camera } = this;
    if (header !== null) this.#left = { source: this.#source, frame, camera, view };
    this.#close();
    this.#late.rest();
    this.#pictures?.dispose();
    this.#pictures = null;
  }

  #close(): void {
    this.#deferred = this.#pausedUnseen = false;
    this.#session.close();
    this.#poster.stand();
    this.#frameCallbacks.begin();
    this.#viewpoint.close();
    this.#late.panels?.refresh();
  }

  #newPictures(): Pictures {
    const host: PicturesHost = {
      size: () => this.#pixels(),
      sort: (depth, serial) => {
        this.#session.send({ type: "view", depth, serial });
      },
      resend: () => {
        this.#session.send({ type: "resend" });
      },
      drawExactly: (camera) => {
        if (this.#session.lost.aborted) this.#pictures?.exactlyDrawn(NO_ANSWER);
        else this.#session.send({ type: "exact", camera });
      },
      lookedThrough: () => {
        const camera = this.recorded ? this.#viewpoint.camera : null;
        return camera === null ? null : { camera, correction: this.info?.corrections.get(camera.name) ?? null };
      },
      cameraMoved: () => {
        this.#viewpoint.moved();
      },
      changed: () => {
        this.#touch();
      },
      cooperative: () => this.getAttribute("gestures") === "cooperative" && document.fullscreenElement !== this && !this.classList.contains("fills"),
      hint: (text) => {
        this.#late.panels?.hint(text);
      },
    };
    const pictures = new Pictures(host, this.#exactChoice);
    pictures.overlay = this.#overlay;
    this.#poster.image.before(...pictures.elements);
    return pictures;
  }

  #opened(header: StreamHeader): void {
    this.#pictures!.layBehind(this.getAttribute("background"), this.#poster.image);
    if (this.getAttribute("aria-label") === this.#ownName) this.#name(header.presentation.title || UNNAMED);
    const left = this.#left;
    this.#left = null;
    this.#viewpoint.open(header, this.#pictures!.stage.navigation, left?.camera || this.getAttribute("camera"), left?.camera === "" ? left.view : null);
    this.#viewpoint.limit(this.getAttribute("limits") === "rig");
    this.#viewpoint.sway(this.hasAttribute("orbit"));
    if (this.quality < 1) this.#chooseQuality();
  }

  #name(text: string): void {
    this.#ownName = text;
    this.setAttribute("aria-label", text);
  }

  #chooseQuality(): void {
    if (this.#pictures === null) return;
    this.#pictures.stage.quality = this.quality;
    this.#session.send({ type: "detail", share: (1 + this.quality) / 2 }); // Gaussians are missed sooner than pixels
    this.#touch();
  }

  async #chooseRecorded(): Promise<void> {
    try {
      if (this.recorded) await startRecorded();
    } catch (error) {
      this.#session.notice(`recorded pictures cannot be shown: ${error instanceof Error ? error.message : String(error)}`);
    }
    this.#touch();
  }

  /** Something to be seen has changed. */
  #touch(): void {
    this.#pictures?.stage.touch();
    this.#late.panels?.refresh();
    this.#wake();
  }

  /** The size of the picture in device pixels. */
  #pixels(): { width: number; height: number } {
    const ratio = this.#ratio.value;
    const { clientWidth, clientHeight } = this;
    return { width: Math.max(1, Math.round(clientWidth * ratio)), height: Math.max(1, Math.round(clientHeight * ratio)) };
  }

  #tell(name: PlayerEvent): void {
    if (name === "play" || name === "seeking") this.#poster.giveWay();
    if (name === "seeked") this.#frameCallbacks.sought();
    this.dispatchEvent(new Event(name));
    this.#late.panels?.refresh();
  }

  #volumeChanged(): void {
    this.#tell("volumechange");
    this.#sightChanged();
  }

  /** A player that nobody sees pauses, unless somebody hears it and its page is shown. */
  get #unseen(): boolean {
    return this.#sight.pageHidden || (this.#sight.offScreen && !this.#session.sound.audible && !this.#headset.entered);
  }

  readonly #sightChanged = (): void => {
    if (!this.#unseen) {
      if (this.#pausedUnseen) this.play().catch(() => undefined);
    } else if (!this.paused) {
      this.pause();
      this.#pausedUnseen = true;
    }
    this.#wake();
  };

  /** Whether playing by itself has to wait until somebody sees it. */
  #waitsToBeSeen(): boolean {
    this.#pausedUnseen ||= this.#unseen;
    return this.#pausedUnseen;
  }
}

/** null: it is no address, or it is relative in a page that has none itself. */
function absolute(address: string): string | null {
  try {
    return new URL(address, document.baseURI).href;
  } catch {
    return null;
  }
}
