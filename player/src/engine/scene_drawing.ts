/**
 * A stream's Gaussians in the context of an engine: in its target as that stands, behind what its depth buffer holds, farthest
 * first. The engine's state is left as it was found.
 */
import { SplatBatches } from "../draw/splat_batches";
import type { Drawing } from "../element/session_host";
import type { Pose } from "../geometry/poses";
import type { Similarity } from "../geometry/similarity";
import type { DepthRow, DrawOrder, SceneUpdate, TextureLayout } from "../messages";
import type { StreamHeader } from "../scene";
import { engineCamera, type EngineView } from "./engine_view";
import { withStateKept } from "./kept_state";

export class SceneDrawing implements Drawing {
  #gl: WebGL2RenderingContext | null = null;
  #layout: TextureLayout | null = null;
  #transform: Similarity | null = null;
  #batches: SplatBatches | null = null;
  #asked: DepthRow | null = null;
  #serial = 0;
  #answered = 0;
  /** Orders up to this one are of another stream. */
  #outdated = 0;
  #ordered = false;
  /** Whether the textures hold a scene: before, parts of one are of no use. */
  #whole = false;

  readonly stage = {
    begin: (): void => {
      this.#asked = null;
      this.#answered = this.#outdated = this.#serial;
      this.#ordered = false;
    },
    load: (update: SceneUpdate | null, draw: DrawOrder): void => {
      const batches = this.#batches;
      this.#whole ||= batches !== null && update?.part === null;
      if (batches !== null && update !== null && this.#gl !== null && this.#whole) {
        withStateKept(this.#gl, () => {
          batches.load(update);
        });
      }
      this.stage.order(draw);
    },
    order: (draw: DrawOrder): void => {
      if (draw.serial <= this.#outdated) return;
      this.#answered = Math.max(this.#answered, draw.serial);
      const batches = this.#batches;
      if (batches === null || this.#gl === null || !this.#whole) return;
      this.#ordered = true;
      withStateKept(this.#gl, () => {
        batches.order(draw);
      });
    },
  };

  constructor(
    private readonly askOrder: (depth: DepthRow, serial: number) => void,
    private readonly resend: () => void,
    private readonly seenFrom: (pose: Pose) => void,
  ) {}

  begin(layout: TextureLayout, header: StreamHeader): void {
    this.#layout = layout;
    this.#transform = header.presentation.transform;
    this.#release();
  }

  readonly exact = false;
  readonly awaitsKernel = false;
  exactlyDrawn(): void {
    // The kernel is never asked.
  }

  /**
   * Draws what there is into the target that is bound; asks for the order that the view needs. Whether anything was drawn. Throws an
   * Error for views that cannot be.
   */
  draw(gl: WebGL2RenderingContext, view: EngineView): boolean {
    if (this.#layout === null || gl.isContextLost()) return false;
    this.#startIn(gl, this.#layout);
    const [, , width, height] = gl.getParameter(gl.VIEWPORT) as Int32Array;
    const converted = engineCamera(view, width, height, this.#transform);
    if (converted === null) return false;
    const { camera, depth, pose } = converted;
    this.seenFrom(pose);
    this.#sortFor(camera.worldToCamera[2] as DepthRow);
    const batches = this.#batches;
    if (batches === null || !this.#ordered) return false;
    withStateKept(gl, () => {
      gl.enable(gl.DEPTH_TEST);
      gl.depthFunc(depth[1] < 0 ? gl.LEQUAL : gl.GEQUAL); // some projections have depths fall with distance
      gl.depthMask(false);
      gl.disable(gl.CULL_FACE);
      gl.enable(gl.BLEND);
      gl.blendEquation(gl.FUNC_ADD);
      gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
      const program = batches.use();
      gl.uniform2f(program.uniform("depth"), ...depth);
      gl.uniform1f(program.uniform("upwards"), view.flipped === true ? -1 : 1);
      gl.uniform1i(program.uniform("linear"), Number(view.linear === true));
      batches.draw(camera, 0, true);
    });
    return true;
  }

  dispose(): void {
    this.#layout = null; // who draws on draws nothing
    this.#leave();
  }

  #leave(): void {
    this.#gl?.canvas.removeEventListener("webglcontextrestored", this.#restored);
    this.#release();
    this.#gl = null;
  }

  #startIn(gl: WebGL2RenderingContext, layout: TextureLayout): void {
    if (gl !== this.#gl) {
      this.#leave();
      this.#gl = gl;
      gl.canvas.addEventListener("webglcontextrestored", this.#restored);
    }
    if (this.#batches !== null) return;
    withStateKept(gl, () => {
      this.#batches = new SplatBatches(gl, layout, true);
    });
    this.#ordered = this.#whole = false;
    this.resend();
  }

  #sortFor(row: DepthRow): void {
    if (this.#asked?.every((part, i) => part === row[i]) || this.#answered < this.#serial) return;
    this.#asked = row;
    this.askOrder(row, ++this.#serial);
  }

  #release(): void {
    this.#batches?.dispose();
    this.#batches = null;
    this.#ordered = false;
  }

  readonly #restored = (): void => {
    this.#batches = null; // with the context that it was of
  };
}
