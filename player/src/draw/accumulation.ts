/**
 * Where colour and transmittance add up, front to back. Half floats: in eight bits, what hundreds of faint Gaussians add
 * is rounded away. Alpha holds the transmittance, which halves keep exactly enough however small it gets.
 */
export class Accumulation {
  private texture: WebGLTexture | null = null;
  private readonly framebuffer: WebGLFramebuffer;
  private readonly format: readonly [GLenum, GLenum];
  private width = 0;
  private height = 0;

  constructor(private readonly gl: WebGL2RenderingContext) {
    this.framebuffer = gl.createFramebuffer();
    const floats = gl.getExtension("EXT_color_buffer_float") ?? gl.getExtension("EXT_color_buffer_half_float");
    this.format = floats === null ? [gl.RGBA8, gl.UNSIGNED_BYTE] : [gl.RGBA16F, gl.HALF_FLOAT];
  }

  /** Binds and clears it: black, all light still passing. */
  begin(width: number, height: number): void {
    const { gl } = this;
    if (this.width !== width || this.height !== height) this.resize(width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.DST_ALPHA, gl.ONE, gl.ZERO, gl.ONE_MINUS_SRC_ALPHA);
  }

  /** Ends it: its texture is bound, and drawing goes to the canvas. */
  end(): void {
    const { gl } = this;
    gl.disable(gl.BLEND);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
  }

  dispose(): void {
    this.gl.deleteTexture(this.texture);
    this.gl.deleteFramebuffer(this.framebuffer);
  }

  private resize(width: number, height: number): void {
    const { gl } = this;
    gl.deleteTexture(this.texture);
    this.texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, this.format[0], width, height);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.texture, 0);
    [this.width, this.height] = [width, height];
  }
}
