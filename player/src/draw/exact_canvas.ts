/**
 * Shows what the decoder's own kernel draws in the worker: exactly the picture of decogs-decode, slower than WebGL2, and
 * without it. Overlays are not drawn.
 */
import type { PinholeCamera } from "../geometry/camera";
import type { ExactPicture } from "../messages";
import type { DrawTimes, Renderer } from "./renderer";

export class ExactCanvas implements Renderer {
  readonly times: DrawTimes = { uploadMs: 0, drawMs: 0 };
  private readonly context: CanvasRenderingContext2D;
  private drawing = false;
  private waiting: PinholeCamera | null = null;
  private done: (() => void)[] = [];

  /** `ask`: has the worker draw; `show` or `failed` is its answer. */
  constructor(
    readonly canvas: HTMLCanvasElement,
    private readonly ask: (camera: PinholeCamera) => void,
  ) {
    const context = canvas.getContext("2d");
    if (context === null) throw new Error("this browser has no canvas");
    this.context = context;
  }

  get busy(): boolean {
    return this.drawing;
  }

  begin(): void {
    this.answered();
  }

  load(): void {
    // The worker has the scene.
  }

  order(): void {
    // The kernel sorts for itself.
  }

  draw(camera: PinholeCamera): void {
    if (this.drawing) {
      this.waiting = camera;
      return;
    }
    this.drawing = true;
    this.ask(camera);
  }

  show({ width, height, pixels, drawMs }: ExactPicture): void {
    Object.assign(this.canvas, { width, height });
    this.context.putImageData(new ImageData(pixels, width, height), 0, 0);
    this.times.drawMs = drawMs;
    this.answered();
  }

  /** No picture came; the one before stays. */
  failed(): void {
    this.answered();
  }

  /** Resolves when the picture asked for last is there. */
  settled(): Promise<void> {
    return this.drawing ? new Promise((done) => this.done.push(done)) : Promise.resolve();
  }

  dispose(): void {
    this.waiting = null;
    this.answered();
  }

  private answered(): void {
    this.drawing = false;
    const next = this.waiting;
    this.waiting = null;
    if (next !== null) {
      this.draw(next);
      return;
    }
    for (const done of this.done.splice(0)) done();
  }
}
