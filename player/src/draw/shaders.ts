/**
 * The shaders: EWA splatting as decoder/rasterise/kernel/project.h does it, with the opacity compensation of the low-pass
 * filter (Yu 2024, Mip-Splatting, equation 9), and compositing from front to back.
 */

const SH = /* glsl */ `
vec3 harmonics(vec3 d, float sh[8 * REST_TEXELS]) {
  #define AT(k) vec3(sh[3 * (k) - 3], sh[3 * (k) - 2], sh[3 * (k) - 1])
  float x = d.x, y = d.y, z = d.z;
  vec3 sum = 0.4886025119029199 * (z * AT(2) - y * AT(1) - x * AT(3));
#if SH_DEGREE > 1
  float xx = x * x, yy = y * y, zz = z * z;
  sum += 1.0925484305920792 * (x * y * AT(4) - y * z * AT(5) - x * z * AT(7))
    + 0.31539156525252005 * (zz + zz - xx - yy) * AT(6) + 0.5462742152960396 * (xx - yy) * AT(8);
#endif
#if SH_DEGREE > 2
  sum += -0.5900435899266435 * y * (xx * 3.0 - yy) * AT(9) + 2.890611442640554 * x * y * z * AT(10)
    - 0.4570457994644658 * y * (zz * 4.0 - xx - yy) * AT(11)
    + 0.3731763325901154 * z * (zz * 2.0 - xx * 3.0 - yy * 3.0) * AT(12)
    - 0.4570457994644658 * x * (zz * 4.0 - xx - yy) * AT(13)
    + 1.445305721320277 * z * (xx - yy) * AT(14) - 0.5900435899266435 * x * (xx - yy * 3.0) * AT(15);
#endif
  return sum;
}
`;

/** Gaussians that one instance draws: one each would cost more than their pixels, in software above all. */
export const BATCH = 128;

/** In a scene of somebody else's: at the depth that its camera's projection gives, for light or for the screen. */
const IN_SCENE = /* glsl */ `
uniform vec2 depth;
uniform float upwards;
uniform bool linear;
vec4 onScreen(vec2 at, float inverse) { return vec4(at.x, upwards * at.y, depth.x + depth.y * inverse, 1.0); }
vec3 shown(vec3 rgb) {
  return linear ? mix(rgb / 12.92, pow((rgb + 0.055) / 1.055, vec3(2.4)), greaterThan(rgb, vec3(0.04045))) : rgb;
}
`;

/** On a canvas of its own. */
const ALONE = /* glsl */ `
vec4 onScreen(vec2 at, float inverse) { return vec4(at, 0.0, 1.0); }
vec3 shown(vec3 rgb) { return rgb; }
`;

/** Four corners of each Gaussian's parallelogram: in the coordinates (u, v) of its conic's Cholesky factor, a square. */
export function splatVertexShader(shDegree: number, restTexels: number, inScene: boolean): string {
  return /* glsl */ `#version 300 es
#define SH_DEGREE ${shDegree}
#define REST_TEXELS ${restTexels}
precision highp float;
precision highp int;
precision highp usampler2D;
const float BLUR = 0.3, CLOSEST = 0.5, HALF_LOG2E = 0.72134752044448170;
const float LOG_SCALE_STEP = 80.0 / 65535.0;
uniform usampler2D base, rest, heat, order;
uniform int count;
uniform bool farthestFirst;
uniform mat3 rotation;
uniform vec3 centre;
uniform vec2 focal, principal, size;
uniform float near;
uniform int overlay;
out vec2 uv;
flat out vec4 paint;
flat out float cut;
${inScene ? IN_SCENE : ALONE}
mat3 turn(uint first, uint others) {
  uint fields[3] = uint[](first, others & 0xffffu, others >> 16);
  vec3 small;
  for (int i = 0; i < 3; ++i) small[i] = (float(fields[i] & 0x7fffu) - 16383.0) / (16383.0 * 1.4142135623730951);
  uint largest = (fields[1] >> 15) | ((fields[2] >> 15) << 1);
  float rest = sqrt(max(0.0, 1.0 - dot(small, small)));
  vec4 q = largest == 0u ? vec4(rest, small) : largest == 1u ? vec4(small.x, rest, small.yz)
    : largest == 2u ? vec4(small.xy, rest, small.z) : vec4(small, rest);
  float w = q.x, x = q.y, y = q.z, z = q.w;
  return mat3(
    1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
    2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
    2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}
${restTexels > 0 ? SH : ""}
// Changes glow from white over orange to red as they age; motion: what never changes in this segment is grey.
vec3 told(vec3 rgb, uint warmth) {
  float luma = dot(rgb, vec3(0.299, 0.587, 0.114));
  if (overlay == 1) {
    float age = 1.0 - float(warmth) / 255.0;
    vec3 glow = mix(vec3(1.0, 0.86, 0.45), vec3(0.93, 0.28, 0.13), smoothstep(0.0, 0.5, age));
    return mix(vec3(0.42 * luma + 0.02), glow, warmth < 2u ? 0.0 : (1.0 - age) * 0.9);
  }
  return warmth == 0u ? vec3(0.42 * luma) * vec3(0.86, 0.97, 1.2) : mix(rgb, vec3(1.0, 0.62, 0.2) * (0.35 + luma), 0.55);
}

void main() {
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  uv = vec2(0.0);
  paint = vec4(0.0);
  cut = 0.0;
  int place = gl_InstanceID * ${BATCH} + (gl_VertexID >> 2);
  if (place >= count) return;
  if (farthestFirst) place = count - 1 - place;
  int index = int(texelFetch(order, ivec2(place & 2047, place >> 11), 0).r);
  ivec2 texel = ivec2((index & 1023) << 1, index >> 10);
  uvec4 low = texelFetch(base, texel, 0), high = texelFetch(base, texel + ivec2(1, 0), 0);
  vec3 offset = uintBitsToFloat(low.xyz) - centre;
  vec3 at = rotation * offset;
  vec3 scale = exp(vec3(float(high.y & 0xffffu), float(high.y >> 16), float(high.z & 0xffffu)) * LOG_SCALE_STEP - 40.0);
  if (!(at.z > 0.0 && at.z >= near && at.z >= CLOSEST * max(scale.x, max(scale.y, scale.z)))) return;

  float inverse = 1.0 / at.z;
  vec2 ray = at.xy * inverse;
  vec2 clamped = clamp(ray, (-0.15 * size - principal) / focal, (1.15 * size - principal) / focal);
  vec2 j = focal * inverse;
  mat3 t = transpose(rotation);
  vec3 t0 = j.x * (t[0] - clamped.x * t[2]), t1 = j.y * (t[1] - clamped.y * t[2]);
  mat3 axes = turn(high.z >> 16, high.w);
  vec3 m0 = (t0 * axes) * scale, m1 = (t1 * axes) * scale, n = cross(m0, m1);
  float a0 = dot(m0, m0), b = dot(m0, m1), c0 = dot(m1, m1), det0 = dot(n, n);
  float a = a0 + BLUR, c = c0 + BLUR, det = det0 + BLUR * (a0 + c0) + BLUR * BLUR;
  float opacity = float(high.x >> 16) / 65535.0 * sqrt(det0 / det);
  float bits = log2(max(opacity * 255.0, 1e-30));
  if (!(bits > 0.0 && det > 0.0)) return;

  vec2 middle = ray * focal + principal;
  vec2 extent = sqrt(bits / HALF_LOG2E * vec2(a, c));
  if (!(all(greaterThan(middle + extent, vec2(0.0))) && all(lessThan(middle - extent, size)) && all(lessThan(extent, vec2(1e9))))) return;
  float p = sqrt(HALF_LOG2E * c / det), q = -(b / det) * HALF_LOG2E / p, r = sqrt(HALF_LOG2E / c);
  uv = sqrt(bits) * vec2((gl_VertexID & 1) == 0 ? -1.0 : 1.0, (gl_VertexID & 2) == 0 ? -1.0 : 1.0);
  float dy = uv.y / r;
  vec2 pixel = middle + vec2((uv.x - q * dy) / p, dy);
  gl_Position = onScreen(vec2(2.0, -2.0) * pixel / size + vec2(-1.0, 1.0), inverse);

  vec3 rgb = 0.5 + 0.28209479177387814 * vec3(unpackHalf2x16(low.w), unpackHalf2x16(high.x).x);
#if SH_DEGREE > 0
  const int PER_LINE = 2048 / REST_TEXELS;
  ivec2 from = ivec2(index % PER_LINE * REST_TEXELS, index / PER_LINE);
  float sh[8 * REST_TEXELS];
  for (int i = 0; i < REST_TEXELS; ++i) {
    uvec4 words = texelFetch(rest, from + ivec2(i, 0), 0);
    for (int k = 0; k < 4; ++k) {
      vec2 pair = unpackHalf2x16(words[k]);
      sh[8 * i + 2 * k] = pair.x;
      sh[8 * i + 2 * k + 1] = pair.y;
    }
  }
  rgb += harmonics(normalize(offset), sh);
#endif
  rgb = max(rgb, 0.0);
  if (overlay != 0) rgb = told(rgb, texelFetch(heat, ivec2(index & 2047, index >> 11), 0).r);
  paint = vec4(shown(rgb), opacity);
  cut = bits;
}
`;
}

/** Colour times alpha, and alpha: blending adds the first under what is there and lowers the transmittance by the second. */
export const SPLAT_FRAGMENT_SHADER = /* glsl */ `#version 300 es
precision highp float;
const float ALPHA_MAX = 0.99;
in vec2 uv;
flat in vec4 paint;
flat in float cut;
out vec4 result;
void main() {
  float exponent = dot(uv, uv);
  if (exponent > cut) discard;
  float alpha = min(ALPHA_MAX, paint.a * exp2(-exponent));
  result = vec4(paint.rgb * alpha, alpha);
}
`;

export const SCREEN_VERTEX_SHADER = /* glsl */ `#version 300 es
void main() {
  gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}
`;

/** What was accumulated, before the background; multiplied with its alpha, which no colour may exceed. */
export const FINISH_FRAGMENT_SHADER = /* glsl */ `#version 300 es
precision highp float;
uniform sampler2D accumulated;
uniform vec4 background;
uniform ivec2 corner;
out vec4 result;
void main() {
  vec4 sum = texelFetch(accumulated, ivec2(gl_FragCoord.xy) - corner, 0);
  vec4 seen = vec4(sum.rgb, 1.0 - sum.a) + sum.a * background;
  result = vec4(min(seen.rgb, seen.a), seen.a);
}
`;

/** Texels of changed Gaussians, each drawn as a point at its slot in a data texture. */
export const PATCH_VERTEX_SHADER = /* glsl */ `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;
uniform usampler2D staged, slots;
uniform ivec2 size;
uniform int texels;
flat out uvec4 words;
ivec2 texelAt(int index) { return ivec2(index & 2047, index >> 11); }
void main() {
  int row = gl_VertexID / texels;
  int slot = int(texelFetch(slots, texelAt(row), 0).r);
  words = texelFetch(staged, texelAt(gl_VertexID), 0);
  int line = size.x / texels;
  ivec2 texel = ivec2(slot % line * texels + gl_VertexID - row * texels, slot / line);
  gl_Position = vec4((vec2(texel) + 0.5) / vec2(size) * 2.0 - 1.0, 0.0, 1.0);
  gl_PointSize = 1.0;
}
`;

export const PATCH_FRAGMENT_SHADER = /* glsl */ `#version 300 es
precision highp float;
precision highp int;
flat in uvec4 words;
out uvec4 result;
void main() { result = words; }
`;
