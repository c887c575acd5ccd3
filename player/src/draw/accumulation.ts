/**
 * Where Gaussians add up. Nearest first into half floats: in fewer bits, what hundreds of faint ones add is rounded away; alpha
 * holds the transmittance, which halves keep exactly enough however small it gets. Or, quicker, farthest first over what lies
 * behind, into ten bits a colour.
 */
export class Accumulation {
  private texture: WebGLTexture | null = null;
  private readonly framebuffer: WebGLFramebuffer;
  private readonly exactFormat: GLenum;
  private format: GLenum = 0;
  private width = 0;
  private height = 0;

  constructor(private readonly gl: WebGL2RenderingContext) {
    this.framebuffer = gl.createFramebuffer();
    const floats = gl.getExtension("EXT_color_buffer_float") ?? gl.getExtension("EXT_color_buffer_half_float");
    this.exactFormat = floats === null ? gl.RGBA8 : gl.RGBA16F;
  }

  /** Binds and clears it: black, all light still passing. `behind`: farthest first over this colour, through which no light passes. */
  begin(width: number, height: number, behind: readonly number[] | null): void {
    const { gl } = this;
    const format = behind === null ? this.exactFormat : gl.RGB10_A2;
    if (this.width !== width || this.height !== height || this.format !== format) this.resize(width, height, format);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    gl.viewport(0, 0, width, height);
    const [red, green, blue, passing] = behind === null ? [0, 0, 0, 1] : [...behind.slice(0, 3), 0];
    gl.clearColor(red, green, blue, passing);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.enable(gl.BLEND);
    if (behind === null) gl.blendFuncSeparate(gl.DST_ALPHA, gl.ONE, gl.ZERO, gl.ONE_MINUS_SRC_ALPHA);
    else gl.blendFuncSeparate(gl.ONE, gl.ONE_MINUS_SRC_ALPHA, gl.ZERO, gl.ZERO);
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

  private resize(width: number, height: number, format: GLenum): void {
    const { gl } = this;
    gl.deleteTexture(this.texture);
    this.texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.texture, 0);
    [this.width, this.height, this.format] = [width, height, format];
  }
}
