/** Draws with WebGL2: quads, in batches that are an instance each, and the background, if any, behind them. */
import type { PinholeCamera } from "../geometry/camera";
import type { DrawOrder, SceneUpdate, TextureLayout } from "../messages";
import { OVERLAYS, type Overlay } from "../player_api";
import type { StreamHeader } from "../scene";
import { Accumulation } from "./accumulation";
import { GpuClock } from "./gpu_clock";
import { linked, type Program } from "./program";
import type { DrawTimes, Renderer, Target } from "./renderer";
import { SplatBatches } from "./splat_batches";
import { recordedPass } from "./recorded";
import type { RecordedPass } from "./recorded_pass";
import { FINISH_FRAGMENT_SHADER, SCREEN_VERTEX_SHADER } from "./shaders";

/** What lives on the GPU and is lost with its context. */
interface Resources {
  readonly splats: SplatBatches;
  readonly finish: Program;
  readonly accumulation: Accumulation;
  readonly clock: GpuClock;
  /** Made when a recorded picture is asked for. */
  recorded: RecordedPass | null;
}

const NOTHING = [0, 0, 0, 0] as const;
/** Names of drivers that draw on the processor: not every browser calls them slow. */
const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;

function nameOf(gl: WebGL2RenderingContext): string {
  const names = gl.getExtension("WEBGL_debug_renderer_info");
  return String(gl.getParameter(names?.UNMASKED_RENDERER_WEBGL ?? gl.RENDERER));
}

export class WebGlRenderer implements Renderer {
  readonly inSoftware: boolean;
  readonly times: DrawTimes = { uploadMs: 0, drawMs: 0 };
  private readonly gl: WebGL2RenderingContext;
  private layout: TextureLayout | null = null;
  /** Red, green, blue, alpha. */
  private background: readonly number[] = [0, 0, 0, 1];
  private resources: Resources | null = null;

  /** `onRestored`: the context was lost and is back; everything has to be loaded again. */
  constructor(
    readonly canvas: HTMLCanvasElement,
    private readonly onRestored: () => void,
    private readonly onLost: () => void,
  ) {
    const options: WebGLContextAttributes = { antialias: false, depth: false, stencil: false, powerPreference: "high-performance" };
    const fast = canvas.getContext("webgl2", { ...options, failIfMajorPerformanceCaveat: true });
    const gl = fast ?? canvas.getContext("webgl2", options);
    if (gl === null) throw new Error("this browser has no WebGL2");
    this.gl = gl;
    this.inSoftware = fast === null || SOFTWARE.test(nameOf(gl));
    canvas.addEventListener("webglcontextlost", this.lost);
    canvas.addEventListener("webglcontextrestored", this.restored);
  }

  get busy(): boolean {
    return this.resources?.clock.busy ?? false;
  }

  begin(layout: TextureLayout, { background, subject }: StreamHeader): void {
    this.release();
    this.layout = layout;
    this.background = subject ? NOTHING : [...background, 1];
    if (!this.gl.isContextLost()) this.resources = this.made(layout);
  }

  load(update: SceneUpdate): void {
    const begun = performance.now();
    this.resources?.splats.load(update);
    this.times.uploadMs = performance.now() - begun;
  }

  order(draw: DrawOrder): void {
    this.resources?.splats.order(draw);
  }

  draw(camera: PinholeCamera, overlay: Overlay, quick: boolean): void {
    const { gl, canvas, resources } = this;
    if (resources === null || gl.isContextLost()) return;
    const { width, height } = camera;
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    const recording = recordedPass() === null ? null : camera.recording;
    if (recording) resources.recorded ??= new (recordedPass()!)(gl, (fragment) => linked(gl, SCREEN_VERTEX_SHADER, fragment));
    const drawn = recording ? resources.recorded!.seenBy(camera, recording) : camera;
    // A subject's alpha, and colours that a camera's exposure makes darker again, need all bits.
    const behind = quick && !recording && this.background[3] === 1 ? this.background : null;
    this.accumulate(resources, drawn, overlay, behind);
    gl.viewport(0, 0, width, height);
    if (recording) resources.recorded!.use(camera, recording, this.background);
    else this.useFinish(resources, this.background, 0, 0);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    resources.clock.start((ms) => (this.times.drawMs = ms));
  }

  get context(): WebGL2RenderingContext {
    return this.gl;
  }

  /** A pinhole's picture for a headset. */
  drawInto(camera: PinholeCamera, overlay: Overlay, { framebuffer, x, y, clear }: Target): void {
    const { gl, resources } = this;
    if (resources === null || gl.isContextLost()) return;
    this.accumulate(resources, camera, overlay, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.viewport(x, y, camera.width, camera.height);
    this.useFinish(resources, clear ? NOTHING : this.background, x, y);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  private accumulate({ accumulation, splats }: Resources, camera: PinholeCamera, overlay: Overlay, behind: readonly number[] | null): void {
    accumulation.begin(camera.width, camera.height, behind);
    splats.use();
    splats.draw(camera, OVERLAYS.indexOf(overlay), behind !== null);
    accumulation.end();
  }

  private useFinish({ finish }: Resources, background: readonly number[], x: number, y: number): void {
    this.gl.useProgram(finish.program);
    this.gl.uniform4fv(finish.uniform("background"), background);
    this.gl.uniform2i(finish.uniform("corner"), x, y);
  }

  dispose(): void {
    this.canvas.removeEventListener("webglcontextlost", this.lost);
    this.canvas.removeEventListener("webglcontextrestored", this.restored);
    this.release();
    this.gl.getExtension("WEBGL_lose_context")?.loseContext();
  }

  private made(layout: TextureLayout): Resources {
    const { gl } = this;
    const finish = linked(gl, SCREEN_VERTEX_SHADER, FINISH_FRAGMENT_SHADER);
    const splats = new SplatBatches(gl, layout);
    return { splats, finish, accumulation: new Accumulation(gl), clock: new GpuClock(gl), recorded: null };
  }

  private release(): void {
    if (this.resources === null) return;
    const { splats, finish, accumulation, clock, recorded } = this.resources;
    clock.stop();
    recorded?.dispose();
    splats.dispose();
    accumulation.dispose();
    this.gl.deleteProgram(finish.program);
    this.resources = null;
  }

  private readonly lost = (event: Event): void => {
    event.preventDefault(); // else it is never given back
    this.resources?.clock.stop();
    this.resources = null;
    this.onLost();
  };

  private readonly restored = (): void => {
    if (this.layout === null) return;
    this.resources = this.made(this.layout);
    this.onRestored();
  };
}
