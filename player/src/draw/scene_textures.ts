/**
 * The data textures of a scene. Whole textures go by texImage2D: on WebGL2 in Chrome, a texSubImage2D of a texture that the
 * picture before still reads waits for that picture (playcanvas/engine#8656: 74 ms against 2).
 */
import { TEXTURE_WIDTH, perLine, textureLines, type SceneUpdate, type TextureLayout } from "../messages";

export class SceneTextures {
  private readonly base: WebGLTexture;
  private readonly rest: WebGLTexture;
  private readonly heat: WebGLTexture;

  constructor(
    private readonly gl: WebGL2RenderingContext,
    private readonly layout: TextureLayout,
  ) {
    this.base = this.texture();
    this.rest = this.texture();
    this.heat = this.texture();
  }

  load(update: SceneUpdate): void {
    const { gl } = this;
    this.words(this.base, 2, update.base, update.count);
    if (update.rest !== null) this.words(this.rest, this.layout.restTexels, update.rest, update.count);
    gl.bindTexture(gl.TEXTURE_2D, this.heat);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    const lines = textureLines(update.count, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8UI, TEXTURE_WIDTH, lines, 0, gl.RED_INTEGER, gl.UNSIGNED_BYTE, update.heat);
  }

  /** Binds the textures to units 0 to 2, in the order base, rest, heat. */
  bind(): void {
    const { gl } = this;
    for (const [unit, texture] of [this.base, this.rest, this.heat].entries()) {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
    }
    gl.activeTexture(gl.TEXTURE0);
  }

  dispose(): void {
    for (const texture of [this.base, this.rest, this.heat]) this.gl.deleteTexture(texture);
  }

  private words(texture: WebGLTexture, texels: number, words: Uint32Array, count: number): void {
    const { gl } = this;
    const [width, lines] = [perLine(texels) * texels, textureLines(count, texels)];
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
