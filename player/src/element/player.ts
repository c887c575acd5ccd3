/** `<decogs-player src="scene.dgs" controls>`: plays a stream, with the manners of <video>. Its members are here; what is behind them is in playout.ts. */
import { adoptAgain } from "../adopted_style";
import type { Lens, PinholeCamera } from "../geometry/camera";
import type { Pose } from "../geometry/poses";
import type { Vector } from "../geometry/vectors";
import type { FrameInfo } from "../messages";
import type { Figures, FrameList, Overlay, Place, PlayerApi, Span, View } from "../player_api";
import type { StreamHeader } from "../scene";
import { AttributeElement, takeOverProperties } from "./attributes";
import { Playout } from "./playout";
import { Ranges } from "./ranges";
import { readyState } from "./ready_state";
import type { Session } from "./session";

/** Where the project's own tests look inside; nothing of it is promised to anybody. */
const INSIDE = Symbol.for("decogs.inside");

export class DecogsPlayer extends AttributeElement implements PlayerApi {
  static readonly observedAttributes = ["src", "crossorigin", "preload", "controls", "autoplay", "loop", "poster", "camera", "exact", "recorded", "background", "orbit", "limits", "fence", "range", "quality", "muted", "max-gaussians", "max-bitrate"];

  readonly #playout = new Playout(this, this.attachShadow({ mode: "open" }));
  #comparing = false;

  connectedCallback(): void {
    takeOverProperties(this);
    this.#playout.enter();
  }

  disconnectedCallback(): void {
    this.#playout.leave();
  }

  adoptedCallback(): void {
    adoptAgain(this.shadowRoot!);
  }

  attributeChangedCallback(name: string, before: string | null, value: string | null): void {
    if (before !== value) this.#playout.attributeChanged(name, value);
  }

  /** The address of the stream that is open. */
  get currentSrc(): string {
    return this.#playout.source;
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

  get refinedFrames(): readonly Span[] {
    return this.#session.refined;
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
    return readyState(this.#session);
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
    this.#session.goTo({ seconds });
  }
  get currentFrame(): number {
    const { position, playback } = this.#session;
    return position === playback.position ? playback.due : Math.floor(position + 1e-6);
  }
  set currentFrame(frame: number) {
    this.#session.goTo({ frame: Math.round(frame) });
  }
  get playbackRate(): number {
    return this.#session.playback.rate;
  }
  set playbackRate(rate: number) {
    this.#session.playback.rate = rate;
    this.#playout.tell("ratechange");
  }

  get overlay(): Overlay {
    return this.#playout.appearance.overlay;
  }
  set overlay(overlay: Overlay) {
    this.#playout.appearance.overlay = overlay;
  }
  get exact(): boolean {
    return this.#playout.pictures?.exact ?? false;
  }
  set exact(value: boolean) {
    this.setAttribute("exact", value ? "" : "off");
  }
  get canChooseExact(): boolean {
    return this.#playout.pictures?.canChooseExact ?? false;
  }
  get comparing(): boolean {
    return this.#comparing;
  }
  set comparing(value: boolean) {
    this.#comparing = value && this.hasAttribute("recordings");
    if (this.#comparing) this.recorded = true;
    this.#playout.controls.panels?.refresh();
    this.#playout.wake();
  }
  get camera(): string {
    return this.#playout.viewpoint.camera?.name ?? "";
  }
  set camera(name: string) {
    this.#playout.viewpoint.lookAt(name);
  }
  get view(): View | null {
    return this.#playout.viewpoint.view;
  }
  get figures(): Figures | null {
    const { pictures } = this.#playout;
    if (pictures === null || this.info === null) return null;
    const { renderer, drawnAt } = pictures.stage;
    const { width, height } = renderer.canvas;
    const { drawn, bytesRead } = this.#session;
    return { pictures: drawnAt.length, width, height, drawn: drawn.count, sortMs: drawn.sortMs, bytesRead, ...renderer.times };
  }

  /** Opens the stream anew, as that of <video>. */
  load(): void {
    if (this.isConnected) this.#playout.open();
  }

  play(): Promise<void> {
    return this.#playout.play();
  }

  pause(): void {
    this.#playout.pause();
  }

  /** Has a function called once, when the next frame has come into the picture; its number, to take it back with. */
  requestVideoFrameCallback(callback: VideoFrameRequestCallback): number {
    return this.#playout.frameCallbacks.request(callback);
  }

  cancelVideoFrameCallback(request: number): void {
    this.#playout.frameCallbacks.cancel(request);
  }

  currentCamera(width?: number, height?: number): PinholeCamera | null {
    return this.#playout.captures.camera(width, height);
  }

  async capture(width?: number, height?: number): Promise<Blob> {
    const picture = await this.#playout.captures.png(width, height);
    this.#playout.wake();
    return picture;
  }

  thumbnail(frame: number, width: number): Promise<ImageData | null> {
    return this.#playout.captures.thumbnail(frame, width);
  }

  ply(): Promise<Blob> {
    return this.#playout.captures.ply();
  }

  lookThrough(index: number, atOnce = false): void {
    this.#playout.viewpoint.lookThrough(index, atOnce);
  }

  nextCamera(step: 1 | -1): void {
    this.#playout.viewpoint.next(step);
  }

  backToCamera(): void {
    this.#playout.viewpoint.back();
  }

  lookFrom(pose: Pose, lens: Lens): void {
    this.#playout.viewpoint.lookFrom(pose, lens);
  }

  async enterXr(mode: "immersive-vr" | "immersive-ar"): Promise<void> {
    const { pictures, headset } = this.#playout;
    if (pictures === null || this.info === null) throw new Error("there is no picture yet");
    await headset.enter(mode, pictures);
    this.#playout.tell("xrstart");
  }

  leaveXr(): Promise<void> {
    return this.#playout.headset.leave();
  }

  fly(direction: Vector): void {
    this.#playout.viewpoint.fly(direction);
  }

  recordedPlace(): Place | null {
    return this.currentCamera(this.clientWidth, this.clientHeight)?.recording ?? null;
  }

  recordingAddress(): string {
    return this.#playout.captures.recordingAddress();
  }

  get [INSIDE](): unknown {
    const { pictures, session, ticking } = this.#playout;
    return { stage: pictures?.stage ?? null, playback: session.playback, ticking };
  }

  get #session(): Session {
    return this.#playout.session;
  }

  #volumeChanged(): void {
    this.#playout.tell("volumechange");
    this.#playout.sightChanged();
  }
}
