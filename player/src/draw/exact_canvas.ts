/**
 * Shows what the decoder's own kernel draws in the worker: exactly the picture of decogs-decode, slower than WebGL2, and
 * without it. Overlays are not drawn.
 */
import type { PinholeCamera } from "../geometry/camera";
import type { ExactPicture } from "../messages";
import type { DrawTimes, Renderer } from "./renderer";

export class ExactCanvas implements Renderer {
  readonly times: DrawTimes = { uploadMs: 0, drawMs: 0 };
  /** Whether nothing of the stream has been shown yet. */
  empty = true;
  private readonly context: CanvasRenderingContext2D;
  private drawing = false;
  private waiting: PinholeCamera | null = null;
  private done: ((problem: string | null) => void)[] = [];

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
    this.empty = true;
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
    this.empty = false;
    this.answered();
  }

  /** No picture came; the one before stays. */
  failed(problem: string | null): void {
    this.answered(problem);
  }

  /** Resolves when the picture asked for last is there, rejects where none came. */
  settled(): Promise<void> {
    if (!this.drawing) return Promise.resolve();
    return new Promise((done, refused) => {
      this.done.push((problem) => {
        if (problem === null) done();
        else refused(new Error(problem));
      });
    });
  }

  dispose(): void {
    this.waiting = null;
    this.answered();
  }

  private answered(problem: string | null = null): void {
    this.drawing = false;
    const next = this.waiting;
    this.waiting = null;
    if (next !== null) {
      this.draw(next);
      return;
    }
    for (const done of this.done.splice(0)) done(problem);
  }
}
