/** Leaves a context as it was found: an engine remembers what it has set, and does not ask for it again. */

/** Texture units that a scene is drawn with. */
const UNITS = 4;

export function withStateKept(gl: WebGL2RenderingContext, work: () => void): void {
  const restore = keptState(gl);
  try {
    work();
  } finally {
    restore();
  }
}

function keptState(gl: WebGL2RenderingContext): () => void {
  // eslint-disable-next-line @typescript-eslint/no-unnecessary-type-parameters -- what a name gives has a type that only its reader knows
  const get = <T>(name: GLenum): T => gl.getParameter(name) as T;
  const enabled = [gl.BLEND, gl.DEPTH_TEST, gl.CULL_FACE, gl.SCISSOR_TEST, gl.STENCIL_TEST, gl.SAMPLE_ALPHA_TO_COVERAGE].map(
    (name) => [name, gl.isEnabled(name)] as const,
  );
  const stored = [gl.UNPACK_ALIGNMENT, gl.UNPACK_FLIP_Y_WEBGL, gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, gl.UNPACK_ROW_LENGTH].map(
    (name) => [name, Number(get(name))] as const,
  );
  const [program, attributes] = [get<WebGLProgram | null>(gl.CURRENT_PROGRAM), get<WebGLVertexArrayObject | null>(gl.VERTEX_ARRAY_BINDING)];
  const [drawn, read] = [get<WebGLFramebuffer | null>(gl.DRAW_FRAMEBUFFER_BINDING), get<WebGLFramebuffer | null>(gl.READ_FRAMEBUFFER_BINDING)];
  const unpacked = get<WebGLBuffer | null>(gl.PIXEL_UNPACK_BUFFER_BINDING);
  const [x, y, width, height] = get<Int32Array>(gl.VIEWPORT);
  const [writes, nearer] = [get<boolean>(gl.DEPTH_WRITEMASK), get<GLenum>(gl.DEPTH_FUNC)];
  const [red, green, blue, alpha] = get<readonly boolean[]>(gl.COLOR_WRITEMASK);
  const equations = [get<GLenum>(gl.BLEND_EQUATION_RGB), get<GLenum>(gl.BLEND_EQUATION_ALPHA)] as const;
  const [fromRgb, toRgb, fromAlpha, toAlpha] = [gl.BLEND_SRC_RGB, gl.BLEND_DST_RGB, gl.BLEND_SRC_ALPHA, gl.BLEND_DST_ALPHA].map(
    (name) => get<GLenum>(name),
  );
  const active = get<GLenum>(gl.ACTIVE_TEXTURE);
  const bound = Array.from({ length: UNITS }, (_, unit) => {
    gl.activeTexture(gl.TEXTURE0 + unit);
    return [get<WebGLTexture | null>(gl.TEXTURE_BINDING_2D), get<WebGLSampler | null>(gl.SAMPLER_BINDING)] as const;
  });
  bound.forEach((_, unit) => {
    gl.bindSampler(unit, null);
  });
  // What textures are filled from is ours, as browsers begin with it.
  for (const [name, value] of [[gl.UNPACK_ALIGNMENT, 4], [gl.UNPACK_FLIP_Y_WEBGL, 0], [gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, 0], [gl.UNPACK_ROW_LENGTH, 0]]) {
    gl.pixelStorei(name, value);
  }
  gl.bindBuffer(gl.PIXEL_UNPACK_BUFFER, null);
  return () => {
    bound.forEach(([texture, sampler], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.bindSampler(unit, sampler);
    });
    gl.activeTexture(active);
    for (const [name, on] of enabled) {
      if (on) gl.enable(name);
      else gl.disable(name);
    }
    for (const [name, value] of stored) gl.pixelStorei(name, value);
    gl.useProgram(program);
    gl.bindVertexArray(attributes);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, drawn);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, read);
    gl.bindBuffer(gl.PIXEL_UNPACK_BUFFER, unpacked);
    gl.viewport(x, y, width, height);
    gl.depthMask(writes);
    gl.depthFunc(nearer);
    gl.colorMask(red, green, blue, alpha);
    gl.blendEquationSeparate(...equations);
    gl.blendFuncSeparate(fromRgb, toRgb, fromAlpha, toAlpha);
  };
}
