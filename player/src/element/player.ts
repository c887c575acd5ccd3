/**
 * `<decogs-player src="scene.dgs" controls>`: plays a stream, with the manners of <video>.
 *
 * Attributes: src, controls, autoplay, loop, poster, camera (a name), follow (the stream is still being written),
 * exact (drawn by the decoder's own kernel, which also draws where WebGL2 is missing), recorded (cameras of the rig show
 * what they recorded: with lens and colours), background (the colour behind a subject; without it, the page shows there).
 * The worker decodes and sorts, the stage draws, the panels are for people; this holds them together.
 */
import { lookedAt, extentOf } from "../camera/looked_at";
import type { Panels } from "../controls/panels";
import { attachPointer } from "../camera/pointer";
import { upOf } from "../camera/up_direction";
import { createRenderer } from "../draw/index";
import { ExactCanvas } from "../draw/exact_canvas";
import { startRecorded } from "../draw/recorded";
import type { Overlay, Renderer } from "../draw/renderer";
import type { Lens, PinholeCamera } from "../geometry/camera";
import { lensOf, poseOf, type Pose } from "../geometry/poses";
import { length, minus } from "../geometry/vectors";
import type { FrameInfo, FromWorker, TextureLayout } from "../messages";
import type { StreamHeader } from "../scene";
import { Connection, FrameColumns } from "./connection";
import type { PlayerEvent } from "./events";
import { DEFAULT_FPS, Playback } from "./playback";
import { Stage, type LookedThrough } from "./stage";
import style from "./style.css";

type Controls = typeof import("../controls/index");

const FOLLOW_MS = 1000;
const LONGEST_STEP = 0.1;
/** When controls come although there is no picture yet. */
const CONTROLS_AFTER_MS = 400;

export class DecogsPlayer extends HTMLElement {
  static readonly observedAttributes = ["src", "controls", "loop", "poster", "camera", "exact", "recorded", "background"];

  /** What is known of the stream; null before `loadedmetadata`. */
  header: StreamHeader | null = null;
  /** What is known of every frame. */
  frames = new FrameColumns();
  /** Of the frame in the picture. */
  info: FrameInfo | null = null;
  /** What went wrong, a sentence; null when nothing. */
  error: string | null = null;
  bytesRead = 0;
  drawn = { count: 0, sortMs: 0 };
  readonly playback = new Playback();
  stage: Stage | null = null;

  private readonly canvas = document.createElement("canvas");
  private readonly exactCanvas = document.createElement("canvas");
  private layout: TextureLayout | null = null;
  private exactly: ExactCanvas | null = null;
  private fast: Renderer | null = null;
  private readonly poster_ = document.createElement("img");
  /** What people act with: a script of its own, which comes behind the first picture. */
  private controls_: Controls | null = null;
  private controlsComing = false;
  private controlsTimer = 0;
  private panels: Panels | null = null;
  private loading = false;
  private connection: Connection | null = null;
  private cameraIndex = -1;
  private requested = -1;
  private requests = 0;
  private seekRequest = -1;
  /** A frame asked for that is not known yet; -1 for none. */
  private seekLater = -1;
  /** Where to begin, asked for before the header had come; the next stream begins there, as with <video>. */
  private start: { readonly seconds: number } | { readonly frame: number } | null = null;
  private ticking = 0;
  private lastTick = 0;
  private followTimer = 0;
  private pausedByHiding = false;
  private comparing_ = false;
  private notice: string | null = null;
  private startAt: { pose: Pose; lens: Lens } | null = null;
  private readonly resized = new ResizeObserver(() => {
    this.stage?.touch();
    this.wake();
  });
  private detachPointer: (() => void) | null = null;

  constructor() {
    super();
    const root = this.attachShadow({ mode: "open" });
    const sheet = document.createElement("style");
    sheet.textContent = style;
    this.canvas.className = "picture";
    this.poster_.className = "poster";
    this.poster_.alt = "";
    // It lies over the other one, which takes what the pointer does.
    this.exactCanvas.className = "picture exact";
    this.exactCanvas.hidden = true;
    root.append(sheet, this.canvas, this.exactCanvas, this.poster_);
  }

  connectedCallback(): void {
    if (!this.hasAttribute("tabindex")) this.tabIndex = 0;
    if (!this.hasAttribute("role")) this.setAttribute("role", "region");
    if (!this.hasAttribute("aria-label")) this.setAttribute("aria-label", "Free-viewpoint video");
    this.resized.observe(this);
    document.addEventListener("visibilitychange", this.visibilityChanged);
    this.addEventListener("keydown", this.keyDown);
    this.addEventListener("keyup", this.keyUp);
    this.addEventListener("blur", this.keysLeft);
    this.open();
  }

  disconnectedCallback(): void {
    this.resized.disconnect();
    document.removeEventListener("visibilitychange", this.visibilityChanged);
    this.removeEventListener("keydown", this.keyDown);
    this.removeEventListener("keyup", this.keyUp);
    this.removeEventListener("blur", this.keysLeft);
    this.closeStream();
    clearTimeout(this.controlsTimer);
    this.detachPointer?.();
    this.detachPointer = null;
    this.fast?.dispose();
    this.exactly?.dispose();
    this.stage = this.fast = this.exactly = null;
  }

  attributeChangedCallback(name: string, before: string | null, value: string | null): void {
    if (before === value) return;
    if (name === "src" && this.isConnected) this.open();
    if (name === "loop") this.playback.loop = value !== null;
    if (name === "poster") this.showPoster(value);
    if (name === "exact") this.chooseRenderer();
    if (name === "recorded") void this.chooseRecorded();
    if (name === "background") this.layBehind();
    if (name === "camera" && value !== null) this.camera = value;
    this.panels?.refresh();
  }

  get src(): string {
    return this.getAttribute("src") ?? "";
  }
  set src(value: string) {
    this.setAttribute("src", value);
  }
  get poster(): string {
    return this.getAttribute("poster") ?? "";
  }
  set poster(value: string) {
    this.setAttribute("poster", value);
  }
  get controls(): boolean {
    return this.hasAttribute("controls");
  }
  set controls(value: boolean) {
    this.toggleAttribute("controls", value);
  }
  get autoplay(): boolean {
    return this.hasAttribute("autoplay");
  }
  set autoplay(value: boolean) {
    this.toggleAttribute("autoplay", value);
  }
  get loop(): boolean {
    return this.hasAttribute("loop");
  }
  set loop(value: boolean) {
    this.toggleAttribute("loop", value);
  }
  get paused(): boolean {
    return !this.playback.playing;
  }
  get ended(): boolean {
    return this.playback.ended;
  }
  get fps(): number {
    return this.playback.fps;
  }
  /** Seconds of all frames known so far; NaN before `loadedmetadata`. */
  get duration(): number {
    return this.header === null ? NaN : this.playback.frameCount / this.fps;
  }
  get currentTime(): number {
    if (this.start !== null) return "seconds" in this.start ? this.start.seconds : this.start.frame / this.fps;
    return this.playback.position / this.fps;
  }
  set currentTime(seconds: number) {
    if (this.header !== null) this.seekFrame(seconds * this.fps);
    else if (Number.isFinite(seconds)) this.start = { seconds: Math.max(0, seconds) };
  }
  /** The frame that is due, counted from 0. */
  get currentFrame(): number {
    return this.start !== null && "frame" in this.start ? this.start.frame : this.playback.due;
  }
  set currentFrame(frame: number) {
    if (this.header !== null) this.seekFrame(Math.round(frame));
    else if (Number.isFinite(frame)) this.start = { frame: Math.max(0, Math.round(frame)) };
  }
  get playbackRate(): number {
    return this.playback.rate;
  }
  set playbackRate(rate: number) {
    if (!(rate > 0 && rate <= 16)) throw new RangeError("playbackRate must be above 0 and at most 16");
    this.playback.rate = rate;
    this.tell("ratechange");
  }
  /** What is painted over the scene: "none", "changes" or "motion". */
  get overlay(): Overlay {
    return this.stage?.overlay ?? "none";
  }
  set overlay(overlay: Overlay) {
    if (this.stage === null) return;
    this.stage.overlay = overlay;
    this.stage.touch();
    this.panels?.refresh();
    this.wake();
  }
  /** Whether the decoder's own kernel draws: slower, and to the bit what decogs-decode writes. */
  get exact(): boolean {
    return this.stage !== null && this.stage.renderer === this.exactly;
  }
  set exact(value: boolean) {
    this.toggleAttribute("exact", value);
  }
  /** Whether a camera of the rig shows what it recorded: its lens, its colours, and where it stood in the frame. */
  get recorded(): boolean {
    return this.hasAttribute("recorded");
  }
  set recorded(value: boolean) {
    this.toggleAttribute("recorded", value);
  }
  /** Whether what a rig camera recorded lies beside its view, which then is as recorded, too. */
  get comparing(): boolean {
    return this.comparing_;
  }
  set comparing(value: boolean) {
    this.comparing_ = value && this.hasAttribute("recordings");
    if (this.comparing_) this.recorded = true;
    this.panels?.refresh();
    this.wake();
  }
  /** Where the camera's own picture lies in the element, in CSS pixels; null for a free camera. */
  recordedPlace(): { readonly left: number; readonly top: number; readonly width: number; readonly height: number } | null {
    const recording = this.currentCamera(this.clientWidth, this.clientHeight)?.recording;
    return recording ?? null;
  }
  /** The address of what the camera looked through recorded in the frame that is shown; empty where there is none. */
  recordingAddress(): string {
    const template = this.getAttribute("recordings");
    if (template === null || this.camera === "" || this.info === null) return "";
    const path = template.replace("{camera}", encodeURIComponent(this.camera)).replace("{frame}", String(this.info.frame));
    return new URL(path, document.baseURI).href;
  }
  /** Whether this browser leaves a choice: without WebGL2 every picture is exact. */
  get canChooseExact(): boolean {
    return this.fast !== null;
  }
  /** The name of the rig's camera that is looked through; empty for a free one. */
  get camera(): string {
    return this.stage?.navigation.moved === true ? "" : (this.header?.cameras[this.cameraIndex]?.name ?? "");
  }
  set camera(name: string) {
    const index = this.header?.cameras.findIndex((camera) => camera.name === name) ?? -1;
    if (index >= 0) this.lookThrough(index);
  }

  /** Resolves once playing has begun. */
  play(): Promise<void> {
    if (this.playback.playing) return Promise.resolve();
    const { playback } = this;
    if (playback.ended || (playback.complete && playback.due >= playback.frameCount - 1)) this.seekFrame(0);
    playback.playing = true;
    playback.ended = false;
    this.tell("play");
    this.wake();
    return Promise.resolve();
  }

  pause(): void {
    this.pausedByHiding = false;
    if (!this.playback.playing) return;
    this.playback.playing = false;
    this.tell("pause");
  }

  /** The camera as it is now, in a picture as large as the element (or so many pixels). */
  currentCamera(width?: number, height?: number): PinholeCamera | null {
    const size = this.pixels();
    return this.stage?.camera(width ?? size.width, height ?? size.height) ?? null;
  }

  /** A PNG of the picture, as large as the element or of so many pixels. */
  async capture(width?: number, height?: number): Promise<Blob> {
    if (this.stage === null || this.info === null) throw new Error("there is no picture yet");
    const size = this.pixels();
    if (this.recorded) await startRecorded();
    const picture = await this.stage.capture(width ?? size.width, height ?? size.height);
    this.wake();
    return picture;
  }

  /** Looks through a camera of the rig, by its place in `header.cameras`. */
  lookThrough(index: number, atOnce = false): void {
    const camera = this.header?.cameras[index];
    if (camera === undefined || this.stage === null) return;
    this.cameraIndex = index;
    this.stage.navigation.goTo(poseOf(camera), lensOf(camera), atOnce);
    this.stage.touch();
    this.cameraMoved();
    this.panels?.tellCamera();
    this.wake();
  }

  /** The camera before or after the one looked through last. */
  nextCamera(step: 1 | -1): void {
    const count = this.header?.cameras.length ?? 0;
    if (count > 0) this.lookThrough((this.cameraIndex + step + count) % count);
  }

  /** Back to the camera looked through last. */
  backToCamera(): void {
    if (this.stage === null || this.header === null) return;
    this.stage.navigation.pivot = lookedAt(this.header.cameras.map(poseOf));
    this.lookThrough(this.cameraIndex);
  }

  /** Looks from anywhere. */
  lookFrom(pose: Pose, lens: Lens): void {
    if (this.stage === null) this.startAt = { pose, lens };
    else {
      this.stage.navigation.goTo(pose, lens, true);
      this.stage.navigation.moved = true;
      this.stage.touch();
      this.cameraMoved();
    }
    this.wake();
  }

  /** Panels call this after they have moved the camera. */
  cameraMoved(): void {
    this.panels?.refresh();
    this.tell("camerachange");
    this.wake();
  }

  /** Something is to be drawn or to be waited for: ticks until it is done. */
  wake(): void {
    if (this.ticking === 0) this.ticking = requestAnimationFrame(this.tick);
  }

  private readonly tick = (now: number): void => {
    this.ticking = 0;
    const { playback, stage } = this;
    const seconds = Math.min(LONGEST_STEP, Math.max(0, (now - this.lastTick) / 1000));
    this.lastTick = now;
    if (stage === null) return;
    const wasPlaying = playback.playing;
    playback.advance(seconds, this.info?.frame ?? playback.due);
    if (playback.frameCount > 0 && playback.due !== this.requested) this.request(playback.due);
    if (stage.step(now, seconds, playback.playing)) this.poster_.hidden = true;
    if (wasPlaying && playback.ended) {
      this.tell("pause");
      this.tell("ended");
    }
    this.panels?.tick(now);
    const waiting = playback.playing || stage.pending || stage.renderer.busy;
    const flying = length(stage.navigation.flight) > 0;
    if (waiting || flying) this.wake();
  };

  private open(): void {
    this.closeStream();
    if (this.src === "") {
      this.startControls();
      return;
    }
    try {
      this.stage ??= this.newStage();
    } catch (error) {
      this.fail(error instanceof Error ? error.message : String(error));
      return;
    }
    this.setLoading(true);
    const { start } = this;
    const first = start === null ? 0 : "frame" in start ? start.frame : null;
    this.requested = first ?? -1;
    this.connection = new Connection(
      new URL(this.src, document.baseURI).href,
      this.hasAttribute("follow"),
      first,
      (message) => {
        this.receive(message);
      },
      (message) => {
        this.fail(message);
      },
    );
  }

  private closeStream(): void {
    clearTimeout(this.followTimer);
    this.connection?.close();
    this.connection = null;
    this.header = this.info = this.error = this.notice = this.layout = null;
    this.warn();
    this.frames = new FrameColumns();
    this.requested = this.seekRequest = this.seekLater = this.cameraIndex = -1;
    this.bytesRead = 0;
    Object.assign(this.playback, { playing: false, ended: false, position: 0, frameCount: 0, complete: false });
    this.panels?.refresh();
  }

  private newStage(): Stage {
    try {
      this.fast = createRenderer(this.canvas, () => this.connection?.send({ type: "resend" }));
    } catch {
      this.fast = null; // without WebGL2 the kernel draws
    }
    const stage = new Stage(
      this.rightRenderer(),
      () => this.pixels(),
      (depth, serial) => this.connection?.send({ type: "view", depth, serial }),
      () => this.lookedThrough(),
    );
    stage.navigation.calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const moved = (): void => {
      this.cameraMoved();
    };
    this.detachPointer = attachPointer(this.canvas, stage.navigation, moved);
    return stage;
  }

  /** The camera of the rig whose recorded picture is to be seen; null for a free one, and for the scene's own colours. */
  private lookedThrough(): LookedThrough | null {
    const { camera: name, header } = this;
    const camera = this.recorded && name !== "" ? header?.cameras.find((each) => each.name === name) : undefined;
    return camera === undefined ? null : { camera, correction: this.info?.corrections.get(name) ?? null };
  }

  private rightRenderer(): Renderer {
    const exact = this.fast === null || this.hasAttribute("exact");
    this.exactCanvas.hidden = !exact;
    this.canvas.style.opacity = exact ? "0" : ""; // the other one may be transparent
    if (!exact) return this.fast!;
    return (this.exactly ??= new ExactCanvas(this.exactCanvas, (camera) => this.connection?.send({ type: "exact", camera })));
  }

  /** A subject lies over the page, or over what `background` names. */
  private layBehind(): void {
    const background = this.getAttribute("background");
    const clear = this.header?.subject ?? background !== null;
    for (const canvas of [this.canvas, this.exactCanvas]) {
      canvas.classList.toggle("clear", clear);
      canvas.style.backgroundColor = clear ? (background ?? "") : "";
    }
  }

  /** What draws from now on begins with the whole frame. */
  private chooseRenderer(): void {
    if (this.stage === null) return;
    const renderer = this.rightRenderer();
    if (renderer === this.stage.renderer) return;
    this.stage.renderer = renderer;
    if (this.layout !== null) renderer.begin(this.layout, this.header!);
    this.connection?.send({ type: "resend" });
    this.stage.touch();
    this.wake();
  }

  private async chooseRecorded(): Promise<void> {
    try {
      if (this.recorded) await startRecorded();
    } catch (error) {
      this.notice = `recorded pictures cannot be shown: ${error instanceof Error ? error.message : String(error)}`;
      this.warn();
    }
    this.stage?.touch();
    this.panels?.refresh();
    this.wake();
  }

  /** Has the controls come, once. Without them the picture still plays. */
  private startControls(): void {
    clearTimeout(this.controlsTimer);
    if (this.controlsComing) return;
    this.controlsComing = true;
    import("../controls/index").then(
      (controls) => {
        this.putControls(controls);
      },
      (error: unknown) => {
        this.controlsComing = false;
        console.error("the player's controls cannot be loaded", error);
      },
    );
  }

  private putControls(controls: Controls): void {
    this.controls_ = controls;
    this.panels = new controls.Panels(this, this.shadowRoot!);
    this.panels.loading(this.loading);
    this.warn();
    this.panels.tellCamera();
    this.panels.refresh();
  }

  /** Before the first picture is there, nothing but what leads to it; where it takes long, people are told. */
  private setLoading(on: boolean): void {
    this.loading = on;
    this.panels?.loading(on);
    clearTimeout(this.controlsTimer);
    if (!on) this.startControls();
    else {
      this.controlsTimer = window.setTimeout(() => {
        this.startControls();
      }, CONTROLS_AFTER_MS);
    }
  }

  private exactlyDrawn({ picture, problem }: Extract<FromWorker, { type: "exact" }>): void {
    if (picture === null) this.exactly?.failed();
    else this.exactly?.show(picture);
    if (problem === null) return;
    this.notice = problem;
    this.warn();
  }

  private receive(message: FromWorker): void {
    switch (message.type) {
      case "opened":
        this.opened(message);
        break;
      case "progress":
        this.bytesRead = message.bytesRead;
        if (message.frames !== null) this.frames.append(message.frames);
        for (const [frame, psnr] of message.psnr) this.frames.psnr.set(frame, psnr);
        this.grown(message.complete);
        this.notice = message.notices.at(-1) ?? null;
        this.warn();
        this.tell("progress");
        break;
      case "frame":
        this.shown(message);
        break;
      case "order":
        this.ordered(message);
        break;
      case "exact":
        this.exactlyDrawn(message);
        break;
      case "notYet":
        this.requested = -1;
        break;
      case "refreshed":
        this.followSoon();
        break;
      case "failed":
        this.fail(message.message);
    }
    this.wake();
  }

  private opened(message: Extract<FromWorker, { type: "opened" }>): void {
    const { header, layout } = message;
    const stage = this.stage!;
    this.header = header;
    this.layout = layout;
    this.frames.append(message.frames);
    this.playback.fps = header.fps ?? DEFAULT_FPS;
    stage.renderer.begin(layout, header);
    this.layBehind();
    this.putCamera(stage, header);
    stage.begin();
    const { start } = this;
    this.start = null;
    this.grown(message.complete);
    if (start !== null) this.seekFrame("frame" in start ? start.frame : start.seconds * this.fps);
    this.tell("loadedmetadata");
    if (this.autoplay) void this.play();
    this.followSoon();
  }

  /** Up and pivot as the rig tells them, and the camera that was asked for, or the first. */
  private putCamera({ navigation }: Stage, { cameras, heldOut }: StreamHeader): void {
    const poses = cameras.map(poseOf);
    navigation.up = upOf(cameras);
    navigation.pivot = lookedAt(poses);
    const centres = poses.map(({ centre }) => centre);
    const distances = centres.map((centre) => length(minus(centre, navigation.pivot))).sort((a, b) => a - b);
    navigation.size = distances[distances.length >> 1] || extentOf(centres) || 1;
    const named = cameras.findIndex(({ name }) => name === this.getAttribute("camera"));
    const seen = cameras.findIndex(({ name }) => !heldOut.includes(name));
    this.lookThrough(named >= 0 ? named : Math.max(0, seen), true);
    if (this.startAt !== null) this.lookFrom(this.startAt.pose, this.startAt.lens);
    this.startAt = null;
  }

  private grown(complete: boolean): void {
    const { playback, frames } = this;
    const longer = frames.count !== playback.frameCount;
    playback.frameCount = frames.count;
    playback.complete = complete;
    if (longer) this.tell("durationchange");
    if (this.seekLater >= 0 && (this.seekLater < frames.count || complete)) this.seekFrame(this.seekLater);
    this.panels?.refresh();
  }

  private shown(message: Extract<FromWorker, { type: "frame" }>): void {
    const { info, update, draw } = message;
    const first = this.info === null;
    const steps = Math.abs(info.frame - (this.info?.frame ?? info.frame));
    if (message.request >= 0) this.playback.note(info.decodeMs + info.packMs + draw.sortMs, steps);
    this.info = info;
    this.stage?.load(update, draw);
    this.drawn = { count: draw.count, sortMs: draw.sortMs };
    this.recycle(draw.order, update?.base, update?.rest, update?.heat, update?.part?.places);
    this.warn();
    if (first) {
      this.setLoading(false);
      this.tell("loadeddata");
    }
    this.tell("timeupdate");
    if (this.seekRequest >= 0 && message.request >= this.seekRequest) {
      this.seekRequest = -1;
      this.tell("seeked");
    }
  }

  private ordered({ draw }: Extract<FromWorker, { type: "order" }>): void {
    this.stage?.order(draw);
    this.drawn = { count: draw.count, sortMs: draw.sortMs };
    this.recycle(draw.order);
  }

  private recycle(...arrays: (Uint32Array | Uint8Array | null | undefined)[]): void {
    const buffers = arrays.flatMap((array) => (array ? [array.buffer as ArrayBuffer] : []));
    const whole = buffers.filter((buffer) => buffer.byteLength > 0);
    this.connection?.send({ type: "recycle", buffers: whole }, whole);
  }

  private request(frame: number): void {
    this.requested = frame;
    this.connection?.send({ type: "show", frame, request: ++this.requests });
  }

  private seekFrame(frame: number): void {
    const { playback } = this;
    if (this.header === null || !Number.isFinite(frame)) return;
    this.seekLater = frame >= playback.frameCount && !playback.complete ? frame : -1;
    playback.position = Math.max(0, Math.min(frame, playback.frameCount - 1));
    playback.ended = false;
    this.tell("seeking");
    this.seekRequest = this.requests + 1;
    this.request(playback.due);
    this.wake();
  }

  private followSoon(): void {
    clearTimeout(this.followTimer);
    if (this.playback.complete || !this.hasAttribute("follow")) return;
    this.followTimer = window.setTimeout(() => this.connection?.send({ type: "refresh" }), FOLLOW_MS);
  }

  private fail(message: string): void {
    this.error = message;
    this.setLoading(false);
    this.warn();
    this.pause();
    this.tell("error");
  }

  /** Says the worst of what is wrong, as long as it is. */
  private warn(): void {
    this.panels?.warn(this.error ?? this.info?.damage ?? this.notice);
  }

  private showPoster(address: string | null): void {
    this.poster_.hidden = address === null || this.info !== null;
    if (address !== null) this.poster_.src = address;
  }

  /** The size of the picture in device pixels. */
  private pixels(): { width: number; height: number } {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth, clientHeight } = this;
    return { width: Math.max(1, Math.round(clientWidth * ratio)), height: Math.max(1, Math.round(clientHeight * ratio)) };
  }

  private tell(name: PlayerEvent): void {
    this.dispatchEvent(new Event(name));
    this.panels?.refresh();
  }

  private readonly visibilityChanged = (): void => {
    if (document.hidden) {
      if (this.paused) return;
      this.pause();
      this.pausedByHiding = true;
    } else if (this.pausedByHiding) void this.play();
  };

  private readonly keyDown = (event: KeyboardEvent): void => {
    if (this.panels === null) this.startControls();
    else if (this.controls_?.looksInto(this, this.panels, event) === true) event.preventDefault();
  };
  private readonly keyUp = (event: KeyboardEvent): void => {
    if (this.panels !== null) this.controls_?.looksInto(this, this.panels, event);
  };
  private readonly keysLeft = (): void => {
    this.controls_?.forgetKeys(this);
    if (this.stage !== null) this.stage.navigation.flight = [0, 0, 0];
  };
}
