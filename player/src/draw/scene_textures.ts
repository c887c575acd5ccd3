/**
 * The data textures of a scene.
 *
 * Whole textures go by texImage2D: on WebGL2 in Chrome, a texSubImage2D of a texture that the picture before still reads
 * waits for that picture (playcanvas/engine#8656: 74 ms against 2). Few rows go as a small texture of their own, and are
 * drawn from there to their slots as points: changed rows lie anywhere, so that lines of a texture rarely stay the same.
 */
import { TEXTURE_WIDTH, perLine, textureLines, type DrawOrder, type SceneUpdate, type TextureLayout } from "../messages";
import { linked, type Program } from "./program";
import { PATCH_FRAGMENT_SHADER, PATCH_VERTEX_SHADER } from "./shaders";

const BASE_TEXELS = 2;

interface WordTexture {
  readonly texture: WebGLTexture;
  readonly texels: number;
  lines: number;
}

export class SceneTextures {
  private readonly base: WordTexture;
  private readonly rest: WordTexture;
  private readonly heat: WebGLTexture;
  private readonly rows: WebGLTexture;
  private readonly staged: WebGLTexture;
  private readonly slots: WebGLTexture;
  private readonly framebuffer: WebGLFramebuffer;
  private readonly patch: Program;

  constructor(
    private readonly gl: WebGL2RenderingContext,
    layout: TextureLayout,
  ) {
    this.base = { texture: this.texture(), texels: BASE_TEXELS, lines: 0 };
    this.rest = { texture: this.texture(), texels: layout.restTexels, lines: 0 };
    [this.heat, this.rows, this.staged, this.slots] = [this.texture(), this.texture(), this.texture(), this.texture()];
    this.framebuffer = gl.createFramebuffer();
    this.patch = linked(gl, PATCH_VERTEX_SHADER, PATCH_FRAGMENT_SHADER);
    gl.useProgram(this.patch.program);
    gl.uniform1i(this.patch.uniform("staged"), 0);
    gl.uniform1i(this.patch.uniform("slots"), 1);
  }

  load(update: SceneUpdate): void {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0);
    if (update.part === null) {
      this.loadWhole(this.base, update.base);
      if (update.rest !== null) this.loadWhole(this.rest, update.rest);
    } else if (update.part.count > 0) {
      this.loadPart(update.part, update.base, update.rest);
    }
    gl.bindTexture(gl.TEXTURE_2D, this.heat);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    const lines = textureLines(update.count, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8UI, TEXTURE_WIDTH, lines, 0, gl.RED_INTEGER, gl.UNSIGNED_BYTE, update.heat);
  }

  /** The rows in the order to draw them, which is not empty. */
  order({ order, count }: DrawOrder): void {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.rows);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32UI, TEXTURE_WIDTH, textureLines(count, 1), 0, gl.RED_INTEGER, gl.UNSIGNED_INT, order);
  }

  /** Binds the textures to units 0 to 3, in the order base, rest, heat, order. */
  bind(): void {
    const { gl } = this;
    for (const [unit, texture] of [this.base.texture, this.rest.texture, this.heat, this.rows].entries()) {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
    }
    gl.activeTexture(gl.TEXTURE0);
  }

  dispose(): void {
    const { gl } = this;
    for (const texture of [this.base.texture, this.rest.texture, this.heat, this.rows, this.staged, this.slots]) {
      gl.deleteTexture(texture);
    }
    gl.deleteFramebuffer(this.framebuffer);
    gl.deleteProgram(this.patch.program);
  }

  private loadWhole(target: WordTexture, words: Uint32Array): void {
    const width = perLine(target.texels) * target.texels;
    target.lines = Math.floor(words.length / (4 * width));
    this.words(target.texture, width, target.lines, words);
  }

  private loadPart(part: NonNullable<SceneUpdate["part"]>, base: Uint32Array, rest: Uint32Array | null): void {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.slots);
    const lines = textureLines(part.count, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32UI, TEXTURE_WIDTH, lines, 0, gl.RED_INTEGER, gl.UNSIGNED_INT, part.slots);
    gl.activeTexture(gl.TEXTURE0);
    gl.useProgram(this.patch.program);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    gl.disable(gl.BLEND);
    this.drawPart(this.base, part.count, base);
    if (rest !== null) this.drawPart(this.rest, part.count, rest);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  private drawPart(target: WordTexture, count: number, words: Uint32Array): void {
    const { gl } = this;
    const points = count * target.texels;
    this.words(this.staged, TEXTURE_WIDTH, textureLines(points, 1), words);
    const width = perLine(target.texels) * target.texels;
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target.texture, 0);
    gl.viewport(0, 0, width, target.lines);
    gl.uniform2i(this.patch.uniform("size"), width, target.lines);
    gl.uniform1i(this.patch.uniform("texels"), target.texels);
    gl.drawArrays(gl.POINTS, 0, points);
  }

  private words(texture: WebGLTexture, width: number, lines: number, words: Uint32Array): void {
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32UI, width, lines, 0, gl.RGBA_INTEGER, gl.UNSIGNED_INT, words);
  }

  private texture(): WebGLTexture {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    return texture;
  }
}
