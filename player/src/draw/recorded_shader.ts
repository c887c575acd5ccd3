/** The shader of pictures as cameras recorded them. */

/**
 * What was accumulated as a camera recorded it: resampled through its lens by OpenCV's cubic interpolation, as the decoder
 * does, then with its colours; those of a subject are its own, not mixed with what it does not cover. Positions are those of the corners of cells, linear between them, or of pixels.
 */
export const RECORDED_FRAGMENT_SHADER = /* glsl */ `#version 300 es
precision highp float;
precision highp sampler2D;
uniform sampler2D accumulated, positions, lamps;
uniform vec3 odds;
uniform vec4 background, place;
uniform vec2 size;
uniform vec2 focal, centre;
uniform float cell, falloff;
uniform vec3 turns;
uniform bool bent;
out vec4 result;
vec4 at(ivec2 pixel) {
  ivec2 all = textureSize(accumulated, 0);
  pixel = clamp(pixel, ivec2(0), all - 1);
  vec4 sum = texelFetch(accumulated, ivec2(pixel.x, all.y - 1 - pixel.y), 0);
  return vec4(sum.rgb, 1.0 - sum.a) + sum.a * background;
}
vec4 weights(float t) {
  const float A = -0.75;
  vec3 d = vec3(t + 1.0, t, 1.0 - t);
  float far = ((A * d.x - 5.0 * A) * d.x + 8.0 * A) * d.x - 4.0 * A;
  vec2 near = ((A + 2.0) * d.yz - (A + 3.0)) * d.yz * d.yz + 1.0;
  return vec4(far, near, 1.0 - far - near.x - near.y);
}
vec2 source(vec2 pixel) {
  if (!bent) return pixel;
  vec2 corner = floor(pixel / cell), part = pixel / cell - corner;
  ivec2 first = ivec2(corner);
  vec2 a = texelFetch(positions, first, 0).xy, b = texelFetch(positions, first + ivec2(1, 0), 0).xy;
  vec2 c = texelFetch(positions, first + ivec2(0, 1), 0).xy, d = texelFetch(positions, first + 1, 0).xy;
  return cell == 1.0 ? a : mix(mix(a, b, part.x), mix(c, d, part.x), part.y);
}
vec4 through(vec2 position) {
  vec2 from = position - 0.5;
  if (any(lessThan(from, vec2(0.0))) || any(greaterThan(from, vec2(textureSize(accumulated, 0) - 1)))) return background;
  ivec2 middle = ivec2(floor(from));
  vec4 across = weights(from.x - float(middle.x)), down = weights(from.y - float(middle.y));
  vec4 sum = vec4(0.0);
  for (int j = 0; j < 4; ++j) for (int i = 0; i < 4; ++i) sum += across[i] * down[j] * at(middle + ivec2(i - 1, j - 1));
  return sum;
}
vec3 lampLight(vec2 share) {
  ivec2 size = textureSize(lamps, 0) / ivec2(2, 1);
  vec2 at = clamp(share * vec2(size) - 0.5, vec2(0.0), vec2(size - 1)), part = fract(at);
  ivec2 first = ivec2(floor(at)), last = min(first + 1, size - 1);
  vec3 wave = vec3(0.0);
  float turn = 6.283185307179586 * fract(turns.x + turns.y * share.y);
  for (int k = 0; k < 2; ++k) {
    ivec4 x = ivec4(2 * first.x + k, 2 * last.x + k, first.y, last.y);
    vec3 upper = mix(texelFetch(lamps, x.xz, 0).rgb, texelFetch(lamps, x.yz, 0).rgb, part.x);
    vec3 lower = mix(texelFetch(lamps, x.xw, 0).rgb, texelFetch(lamps, x.yw, 0).rgb, part.x);
    wave += (k == 0 ? sin(turn) : cos(turn)) * mix(upper, lower, part.y);
  }
  return clamp(1.0 + wave, 0.125, 8.0);
}
void main() {
  vec2 pixel = vec2(gl_FragCoord.x, size.y - gl_FragCoord.y);
  result = vec4(0.0, 0.0, 0.0, background.a);
  if (any(lessThan(pixel, place.xy)) || any(greaterThan(pixel, place.zw))) return;
  vec2 from = source(pixel), tangent = (from - centre) / focal;
  vec4 seen = bent ? through(from) : at(ivec2(pixel));
  float light = from.x < -1e8 ? 1.0 : 1.0 + falloff * dot(tangent, tangent);
  vec3 factors = odds / (light * light);
  if (turns.z > 0.0) factors *= lampLight((pixel - place.xy) / (place.zw - place.xy));
  float covered = max(clamp(seen.a, 0.0, 1.0), background.a);
  vec3 v = seen.rgb / max(covered, 1e-6);
  vec3 inside = clamp(v, 0.0, 1.0);
  vec3 recorded = min(factors * inside / (1.0 + (factors - 1.0) * inside), 1.0);
  result = vec4(clamp(mix(v, recorded, equal(v, inside)), 0.0, 1.0) * covered, covered);
}
`;
