/** Draws with WebGL2: quads, nearest first, in batches that are an instance each, into half floats, and the background, if any, behind them. */
import type { PinholeCamera } from "../geometry/camera";
import type { DrawOrder, SceneUpdate, TextureLayout } from "../messages";
import { OVERLAYS, type Overlay } from "../player_api";
import type { StreamHeader } from "../scene";
import { Accumulation } from "./accumulation";
import { GpuClock } from "./gpu_clock";
import { linked, type Program } from "./program";
import type { DrawTimes, Renderer, Target } from "./renderer";
import { SceneTextures } from "./scene_textures";
import { recordedPass } from "./recorded";
import type { RecordedPass } from "./recorded_pass";
import { BATCH, FINISH_FRAGMENT_SHADER, SCREEN_VERTEX_SHADER, SPLAT_FRAGMENT_SHADER, splatVertexShader } from "./shaders";

/** What lives on the GPU and is lost with its context. */
interface Resources {
  readonly splats: Program;
  readonly finish: Program;
  readonly textures: SceneTextures;
  readonly accumulation: Accumulation;
  readonly clock: GpuClock;
  /** Corners of the quads of a batch. */
  readonly corners: WebGLBuffer;
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
  private count = 0;

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
    this.count = 0;
    if (!this.gl.isContextLost()) this.resources = this.made(layout);
  }

  load(update: SceneUpdate): void {
    const begun = performance.now();
    this.resources?.textures.load(update);
    this.times.uploadMs = performance.now() - begun;
  }

  order(draw: DrawOrder): void {
    if (this.resources === null) return;
    this.count = draw.count;
    if (draw.count > 0) this.resources.textures.order(draw);
  }

  draw(camera: PinholeCamera, overlay: Overlay): void {
    const { gl, canvas, resources } = this;
    if (resources === null || gl.isContextLost()) return;
    const { width, height } = camera;
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    const recording = recordedPass() === null ? null : camera.recording;
    if (recording) resources.recorded ??= new (recordedPass()!)(gl, (fragment) => linked(gl, SCREEN_VERTEX_SHADER, fragment));
    const drawn = recording ? resources.recorded!.seenBy(camera, recording) : camera;
    this.accumulate(resources, drawn, overlay);
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
    this.accumulate(resources, camera, overlay);
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.viewport(x, y, camera.width, camera.height);
    this.useFinish(resources, clear ? NOTHING : this.background, x, y);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  private accumulate({ accumulation, splats, textures }: Resources, camera: PinholeCamera, overlay: Overlay): void {
    const { gl } = this;
    accumulation.begin(camera.width, camera.height);
    gl.useProgram(splats.program);
    this.setCamera(splats, camera);
    gl.uniform1i(splats.uniform("overlay"), OVERLAYS.indexOf(overlay));
    textures.bind();
    gl.uniform1i(splats.uniform("count"), this.count);
    gl.drawElementsInstanced(gl.TRIANGLES, 6 * BATCH, gl.UNSIGNED_SHORT, 0, Math.ceil(this.count / BATCH));
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

  private setCamera(program: Program, camera: PinholeCamera): void {
    const { gl } = this;
    const uniform = (name: string): WebGLUniformLocation | null => program.uniform(name);
    const [x, y, z] = camera.worldToCamera as readonly (readonly [number, number, number, number])[];
    const centre = [0, 1, 2].map((axis) => -(x[axis] * x[3] + y[axis] * y[3] + z[axis] * z[3]));
    const columns = [0, 1, 2].flatMap((axis) => [x[axis], y[axis], z[axis]]);
    gl.uniformMatrix3fv(uniform("rotation"), false, columns);
    gl.uniform3fv(uniform("centre"), centre);
    gl.uniform2f(uniform("focal"), camera.fx, camera.fy);
    gl.uniform2f(uniform("principal"), camera.cx, camera.cy);
    gl.uniform2f(uniform("size"), camera.width, camera.height);
    gl.uniform1f(uniform("near"), camera.near);
  }

  private made(layout: TextureLayout): Resources {
    const { gl } = this;
    const splats = linked(gl, splatVertexShader(layout.shDegree, layout.restTexels), SPLAT_FRAGMENT_SHADER);
    const finish = linked(gl, SCREEN_VERTEX_SHADER, FINISH_FRAGMENT_SHADER);
    gl.useProgram(splats.program);
    for (const [unit, name] of ["base", "rest", "heat", "order"].entries()) gl.uniform1i(splats.uniform(name), unit);
    const corners = gl.createBuffer();
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, corners);
    const quads = Array.from({ length: BATCH }, (_, quad) => [0, 1, 2, 2, 1, 3].map((corner) => 4 * quad + corner));
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, Uint16Array.from(quads.flat()), gl.STATIC_DRAW);
    const [textures, accumulation, clock] = [new SceneTextures(gl, layout), new Accumulation(gl), new GpuClock(gl)];
    return { splats, finish, textures, accumulation, clock, corners, recorded: null };
  }

  private release(): void {
    if (this.resources === null) return;
    const { splats, finish, textures, accumulation, clock, corners, recorded } = this.resources;
    clock.stop();
    recorded?.dispose();
    textures.dispose();
    accumulation.dispose();
    for (const { program } of [splats, finish]) this.gl.deleteProgram(program);
    this.gl.deleteBuffer(corners);
    this.resources = null;
  }

  private readonly lost = (event: Event): void => {
    event.preventDefault(); // else it is never given back
    this.resources?.clock.stop();
    this.resources = null;
    this.count = 0;
    this.onLost();
  };

  private readonly restored = (): void => {
    if (this.layout === null) return;
    this.resources = this.made(this.layout);
    this.onRestored();
  };
}
