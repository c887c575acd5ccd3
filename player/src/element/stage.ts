/**
 * What is in the picture: the renderer, the camera that a person moves, and when to draw. Nothing is drawn while nothing
 * changes. On a slow GPU, pictures are drawn quickly and smaller while they change, and whole as soon as they rest.
 */
import { Navigation } from "../camera/navigation";
import type { Renderer } from "../draw/renderer";
import type { PinholeCamera } from "../geometry/camera";
import { fittedLens, worldToCamera } from "../geometry/poses";
import { asItStood, recordingOf } from "../geometry/recorded";
import { intoScene, rowIntoScene, type Similarity } from "../geometry/similarity";
import type { DepthRow, DrawOrder, SceneUpdate } from "../messages";
import type { Overlay } from "../player_api";
import type { CameraCorrection, RigCamera } from "../scene";

const SLOW_MS = 45;
const FAST_MS = 18;
const SMALLEST = 0.4;
/** Half the pixels have to take less than this share of the time. */
const HELPS = 0.85;
/** Milliseconds after the last change until the whole picture is drawn. */
const REST_MS = 160;
const LARGEST_SIDE = 8192;

/** A camera of the rig that is looked through, and what the frame tells of it. */
export interface LookedThrough {
  readonly camera: RigCamera;
  readonly correction: CameraCorrection | null;
}

export class Stage {
  readonly navigation = new Navigation();
  overlay: Overlay = "none";
  /** From the scene that the renderer has to the world of all cameras here; null where they are one. */
  transform: Similarity | null = null;
  /** Of the element's pixels, so large a share is drawn, if not less. */
  quality = 1;
  drawnAt: number[] = [];
  private scale = 1;
  /** Of the picture that was timed last; and the one before that was shrunk, with what it took. */
  private drawnScale = 1;
  private larger: { readonly scale: number; readonly ms: number } | null = null;
  /** Whether a picture was slow, and none since then fast. */
  private slow = false;
  /** Whether shrinking has not helped. */
  private futile = false;
  private dirty = false;
  private changedAt = 0;
  private wholeDrawn = false;
  private count = 0;
  private asked: DepthRow | null = null;
  private serial = 0;
  private answered = 0;
  /** Orders up to this one were asked for before the scene had a camera. */
  private outdated = 0;
  /** Whether an order came for the scene; before, it cannot be drawn. */
  private ordered = false;

  constructor(
    private drawing: Renderer,
    private readonly sizeOf: () => { readonly width: number; readonly height: number },
    private readonly askOrder: (depth: DepthRow, serial: number) => void,
    /** Whose picture is to look as it was recorded; null: nobody's. */
    private readonly recorded: () => LookedThrough | null = () => null,
  ) {}

  get renderer(): Renderer {
    return this.drawing;
  }

  /** Another one may be slow elsewhere. It has the scene once the next order has come. */
  set renderer(renderer: Renderer) {
    this.drawing = renderer;
    this.ordered = false;
    this.scale = 1;
    this.slow = this.futile = false;
    this.larger = null;
    this.touch();
  }

  /** Whether the next picture is still to come. */
  get pending(): boolean {
    return this.dirty || !this.wholeDrawn;
  }

  get hasScene(): boolean {
    return this.count > 0;
  }

  /** Another stream begins: its scene and orders come from another worker. */
  begin(): void {
    this.asked = null;
    this.answered = this.outdated = this.serial;
    this.ordered = false;
    this.slow = this.futile = false;
    this.larger = null;
    this.count = 0;
    this.look();
  }

  load(update: SceneUpdate | null, draw: DrawOrder): void {
    if (update !== null) {
      this.renderer.load(update);
      this.count = update.count;
    }
    this.order(draw);
  }

  order(draw: DrawOrder): void {
    if (draw.serial <= this.outdated) return; // the worker did not know yet from where the scene is looked at
    this.ordered = true;
    this.answered = Math.max(this.answered, draw.serial);
    this.renderer.order(draw);
    this.touch();
  }

  /** What the renderer had is gone: nothing is drawn until it is sent again. */
  forget(): void {
    this.ordered = false;
  }

  /** Something to be seen has changed. */
  touch(): void {
    this.dirty = true;
    this.wholeDrawn = false;
  }

  /** The camera of a picture of so many pixels. */
  camera(width: number, height: number): PinholeCamera {
    const lens = fittedLens(this.navigation.lens, width, height);
    const recorded = this.navigation.jumping ? null : this.recorded();
    const recording = recorded === null ? null : recordingOf(recorded.camera, recorded.correction, lens);
    return { ...lens, worldToCamera: this.standing(recorded), recording };
  }

  /** Moves the camera, asks for the order it needs, and draws when there is something new and the GPU is free. */
  step(now: number, seconds: number, playing: boolean): boolean {
    const moved = this.navigation.step(seconds);
    if (moved || playing || this.dirty) this.changedAt = now;
    if (moved) this.touch();
    this.look();
    if (!this.ordered) return false;
    const resting = !moved && !playing && now - this.changedAt > REST_MS;
    if (this.renderer.busy || (!this.dirty && !(resting && !this.wholeDrawn))) return false;
    this.adapt();
    const scale = resting ? 1 : this.scale;
    const quick = this.slow && !resting;
    this.drawNow(scale, quick);
    this.drawnScale = scale;
    this.dirty = false;
    this.wholeDrawn = scale === 1 && !quick;
    this.drawnAt.push(now);
    while (this.drawnAt[0] < now - 1000) this.drawnAt.shift();
    return true;
  }

  /** A picture of the present view of so many pixels, as PNG. `lost`: of who sorts, and may draw. */
  async capture(width: number, height: number, lost: AbortSignal): Promise<Blob> {
    this.look();
    while (!this.ordered || this.answered < this.serial) {
      lost.throwIfAborted();
      await new Promise((done) => setTimeout(done, 5));
    }
    const { renderer } = this;
    this.drawSized(width, height, false);
    try {
      await renderer.settled?.();
    } catch (error) {
      if (this.renderer === renderer) throw error;
      return this.capture(width, height, lost); // another one draws instead
    }
    lost.throwIfAborted();
    const blob = new Promise<Blob | null>((done) => {
      renderer.canvas.toBlob(done, "image/png");
    });
    this.touch();
    const picture = await blob;
    if (picture === null) throw new Error("the picture cannot be saved; try a smaller window");
    return picture;
  }

  private standing(recorded: LookedThrough | null): readonly (readonly number[])[] {
    return asItStood(worldToCamera(this.navigation.pose), recorded?.correction ?? null);
  }

  /** Asks for the order that the camera needs. */
  private look(): void {
    const [, , row] = this.standing(this.recorded()) as readonly DepthRow[];
    this.sortFor(row);
  }

  /** Asks for the order of a view, if another one than before. */
  sortFor(worldRow: DepthRow): void {
    const row = rowIntoScene(worldRow, this.transform);
    if (this.asked?.every((part, i) => part === row[i]) || this.answered < this.serial) return;
    this.asked = row;
    this.askOrder(row, ++this.serial);
  }

  private drawNow(scale: number, quick: boolean): void {
    const { width, height } = this.sizeOf();
    const shrunk = scale * Math.sqrt(this.quality);
    const side = (length: number): number => Math.max(1, Math.min(LARGEST_SIDE, Math.round(length * shrunk)));
    this.drawSized(side(width), side(height), quick);
  }

  private drawSized(width: number, height: number, quick: boolean): void {
    this.renderer.draw(intoScene(this.camera(width, height), this.transform), this.overlay, quick || this.quality < 1);
  }

  /** Smaller pictures while that helps: where Gaussians, not pixels, take the time, it would only blur. */
  private adapt(): void {
    const { drawMs } = this.renderer.times;
    const { larger, drawnScale } = this;
    if (drawMs > SLOW_MS && !this.slow) this.slow = true;
    else if (drawMs > SLOW_MS && !this.futile) {
      if (larger !== null && drawnScale < larger.scale && drawMs > HELPS * larger.ms) {
        this.futile = true;
        this.scale = 1;
        return;
      }
      this.larger = { scale: drawnScale, ms: drawMs };
      this.scale = Math.max(SMALLEST, this.scale * 0.7);
    } else if (drawMs < FAST_MS) {
      this.slow &&= this.scale < 1;
      this.scale = Math.min(1, this.scale / 0.9);
    }
  }
}
