/** A scene's quads in its data textures, drawn in batches that are an instance each; target and blending are the caller's. */
import type { PinholeCamera } from "../geometry/camera";
import type { DrawOrder, SceneUpdate, TextureLayout } from "../messages";
import { linked, type Program } from "./program";
import { SceneTextures } from "./scene_textures";
import { BATCH, SPLAT_FRAGMENT_SHADER, splatVertexShader } from "./shaders";

export class SplatBatches {
  private readonly program: Program;
  private readonly textures: SceneTextures;
  private readonly corners: WebGLBuffer;
  private readonly attributes: WebGLVertexArrayObject;
  private count = 0;

  constructor(
    private readonly gl: WebGL2RenderingContext,
    { shDegree, restTexels }: TextureLayout,
    inScene = false,
  ) {
    this.program = linked(gl, splatVertexShader(shDegree, restTexels, inScene), SPLAT_FRAGMENT_SHADER);
    gl.useProgram(this.program.program);
    for (const [unit, name] of ["base", "rest", "heat", "order"].entries()) gl.uniform1i(this.program.uniform(name), unit);
    this.attributes = gl.createVertexArray();
    gl.bindVertexArray(this.attributes);
    this.corners = gl.createBuffer();
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.corners);
    const quads = Array.from({ length: BATCH }, (_, quad) => [0, 1, 2, 2, 1, 3].map((corner) => 4 * quad + corner));
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, Uint16Array.from(quads.flat()), gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    this.textures = new SceneTextures(gl, { shDegree, restTexels });
  }

  load(update: SceneUpdate): void {
    this.textures.load(update);
  }

  order(draw: DrawOrder): void {
    this.count = draw.count;
    if (draw.count > 0) this.textures.order(draw);
  }

  /** Makes its program the one that uniforms are set of; resolves their names. */
  use(): Program {
    this.gl.useProgram(this.program.program);
    return this.program;
  }

  /** After `use`. */
  draw(camera: PinholeCamera, overlay: number, farthestFirst: boolean): void {
    const { gl, program } = this;
    setCamera(gl, program, camera);
    gl.uniform1i(program.uniform("overlay"), overlay);
    gl.uniform1i(program.uniform("count"), this.count);
    gl.uniform1i(program.uniform("farthestFirst"), Number(farthestFirst));
    this.textures.bind();
    gl.bindVertexArray(this.attributes);
    gl.drawElementsInstanced(gl.TRIANGLES, 6 * BATCH, gl.UNSIGNED_SHORT, 0, Math.ceil(this.count / BATCH));
    gl.bindVertexArray(null);
  }

  dispose(): void {
    this.textures.dispose();
    this.gl.deleteProgram(this.program.program);
    this.gl.deleteBuffer(this.corners);
    this.gl.deleteVertexArray(this.attributes);
  }
}

function setCamera(gl: WebGL2RenderingContext, program: Program, camera: PinholeCamera): void {
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
