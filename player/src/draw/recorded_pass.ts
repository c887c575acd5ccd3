/** The last pass of a picture as a camera recorded it: what was accumulated, resampled through the lens, in its colours. */
import type { PinholeCamera } from "../geometry/camera";
import type { LampsNow, Recording } from "../geometry/camera";
import { NOWHERE, lensPlan, type LensPlan } from "../geometry/recorded";
import type { Program } from "./program";
import { RECORDED_FRAGMENT_SHADER } from "./recorded_shader";

/** Pixels between positions that are computed; between them a lens is straight to some thousandths of a pixel. */
const CELL = 8;

/** No draw is valid while a sampler's unit has a texture of another kind, even if it is not looked at. */
const NO_LAMPS: LampsNow = { turns: 0, turnsDown: 0, columns: 1, rows: 1, cells: new Float32Array(8) };

export class RecordedPass {
  private readonly program: Program;
  private readonly texture: WebGLTexture;
  private readonly lampCells: WebGLTexture;
  private plan: LensPlan | null = null;
  private planOf = "";

  /** `screen`: makes a program that paints the whole picture. */
  constructor(
    private readonly gl: WebGL2RenderingContext,
    screen: (fragment: string) => Program,
  ) {
    this.program = screen(RECORDED_FRAGMENT_SHADER);
    this.texture = gl.createTexture();
    this.lampCells = gl.createTexture();
  }

  /** The pinhole camera to accumulate for a picture. */
  seenBy(camera: PinholeCamera, { lens }: Recording): PinholeCamera {
    if (lens === null) return camera;
    const { width, height, fx, fy, cx, cy } = camera;
    const wanted = JSON.stringify([width, height, fx, fy, cx, cy, lens.distortionModel, lens.distortion]);
    if (this.plan === null || this.planOf !== wanted) {
      this.plan = lensPlan(camera, lens, CELL);
      // Where a lens folds inside the picture, no cell is straight.
      if (this.plan.positions.includes(NOWHERE)) this.plan = lensPlan(camera, lens, 1);
      this.planOf = wanted;
      this.upload(this.plan);
    }
    const { width: wide, height: high, cx: middle, cy: centre } = this.plan.camera;
    return { ...camera, width: wide, height: high, cx: middle, cy: centre };
  }

  /** Makes the pass ready to be drawn; what was accumulated is bound to unit 0. */
  use(camera: PinholeCamera, recording: Recording, background: readonly number[]): void {
    const { gl, program } = this;
    const { lens, odds, falloff, lamps, left, top, width, height } = recording;
    const drawn = this.seenBy(camera, recording);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    this.uploadLamps(lamps ?? NO_LAMPS);
    gl.activeTexture(gl.TEXTURE0);
    gl.useProgram(program.program);
    gl.uniform1i(program.uniform("accumulated"), 0);
    gl.uniform1i(program.uniform("positions"), 1);
    gl.uniform1i(program.uniform("lamps"), 2);
    gl.uniform3f(program.uniform("turns"), lamps?.turns ?? 0, lamps?.turnsDown ?? 0, lamps === null ? 0 : 1);
    gl.uniform4fv(program.uniform("background"), background);
    gl.uniform3fv(program.uniform("odds"), odds ?? [1, 1, 1]);
    gl.uniform4f(program.uniform("place"), left, top, left + width, top + height);
    gl.uniform2f(program.uniform("size"), camera.width, camera.height);
    gl.uniform2f(program.uniform("focal"), drawn.fx, drawn.fy);
    gl.uniform2f(program.uniform("centre"), drawn.cx, drawn.cy);
    gl.uniform1f(program.uniform("falloff"), falloff);
    gl.uniform1f(program.uniform("cell"), this.plan?.cell ?? 1);
    gl.uniform1i(program.uniform("bent"), lens === null ? 0 : 1);
  }

  dispose(): void {
    this.gl.deleteTexture(this.texture);
    this.gl.deleteTexture(this.lampCells);
    this.gl.deleteProgram(this.program.program);
  }

  private upload({ columns, rows, positions }: LensPlan): void {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RG32F, columns, rows, 0, gl.RG, gl.FLOAT, positions);
    this.unfiltered();
    gl.activeTexture(gl.TEXTURE0);
  }

  /** Into unit 2, where textures of another kind may be bound: sine and cosine of a cell beside each other. */
  private uploadLamps({ columns, rows, cells }: LampsNow): void {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE2);
    gl.bindTexture(gl.TEXTURE_2D, this.lampCells);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, 2 * columns, rows, 0, gl.RGBA, gl.FLOAT, cells);
    this.unfiltered();
  }

  private unfiltered(): void {
    const { gl } = this;
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
  }
}
