/** The shaders, in GLSL ES 3.00; `source` puts the version and the constants in front. */

import * as recipe from "./recipe.js";

/**
 * @param {string} body
 * @param {Record<string, number>} defines
 */
export function source(body, defines) {
  const lines = Object.entries(defines).map(([name, value]) => `#define ${name} ${value}`);
  const head = ["#version 300 es", "precision highp float;", "precision highp int;"];
  return [...head, "precision highp usampler2D;", ...lines, body].join("\n");
}

/** A number as GLSL reads a float. @param {number} x */
function float(x) {
  return Number.isInteger(x) ? x.toFixed(1) : String(x);
}

/**
 * Makes the texels of a Gaussian from its numbers: mean 3, opacity, covariance 6, colour 3, linear
 * harmonics 9. Every texel is one point; all points of a Gaussian compute the same.
 */
const EXPANDED = /* glsl */ `
uniform usampler2D staged;

flat out uvec4 texel;

uint word(int item, int n) {
  int at = item * ITEM_WORDS + n;
  return texelFetch(staged, ivec2(at / 4 % STAGED_WIDTH_PX, at / 4 / STAGED_WIDTH_PX), 0)[at % 4];
}

void finish(uint slot, int n, vec3 mean, vec3 log_scales, vec4 quat, float opacity, vec3 dc,
            vec3 first, vec3 second, vec3 third) {
  vec4 q = quat / length(quat);
  mat3 turned = mat3(
    1.0 - 2.0 * (q.z * q.z + q.w * q.w), 2.0 * (q.y * q.z + q.x * q.w), 2.0 * (q.y * q.w - q.x * q.z),
    2.0 * (q.y * q.z - q.x * q.w), 1.0 - 2.0 * (q.y * q.y + q.w * q.w), 2.0 * (q.z * q.w + q.x * q.y),
    2.0 * (q.y * q.w + q.x * q.z), 2.0 * (q.z * q.w - q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z));
  vec3 scales = exp(log_scales);
  mat3 stretched = mat3(turned[0] * scales.x, turned[1] * scales.y, turned[2] * scales.z);
  mat3 cov = stretched * transpose(stretched);
  vec3 colour = 0.5 + ${float(recipe.SH_C0)} * dc;
  vec4 found = vec4(0.0);
  if (n == 0) found = vec4(mean, opacity);
  else if (n == 1) found = vec4(cov[0][0], cov[0][1], cov[0][2], cov[1][1]);
  else if (n == 2) found = vec4(cov[1][2], cov[2][2], colour.rg);
  else if (n == 3) found = vec4(colour.b, first);
  else if (n == 4) found = vec4(second, third.r);
  else found = vec4(third.gb, 0.0, 0.0);
  texel = floatBitsToUint(found);
  ivec2 at = ivec2((int(slot) % COLUMNS) * TEXELS + n, int(slot) / COLUMNS);
  gl_Position = vec4((vec2(at) + 0.5) / size_px * 2.0 - 1.0, 0.0, 1.0);
  gl_PointSize = 1.0;
}
`;

/**
 * Gaussians on a lattice: three positions of 24 bits, each with a log scale behind it, slot and layer,
 * then the other attributes, a byte each.
 */
export const EXPAND_LATTICE = /* glsl */ `
uniform vec2 size_px;
uniform vec4 steps[16];         // of each layer: position, log scale, log scale's base, rotation
uniform vec2 more_steps[16];    // colour, opacity levels - 1

${EXPANDED}

int code_of(int item, int i) {
  return int(word(item, 4 + i / 4) << (24 - 8 * (i % 4))) >> 24;
}

vec3 rgb(int item, int c, float size) {
  float y = float(code_of(item, 3 + c)) * size;
  float co = float(code_of(item, 3 + K + c)) * size;
  float cg = float(code_of(item, 3 + 2 * K + c)) * size;
  return vec3(y - cg + co, y + cg, y - cg - co);
}

void main() {
  int item = gl_VertexID / TEXELS;
  uint place = word(item, 3);
  int layer = int(place >> 24);
  vec4 sizes = steps[layer];
  vec2 more = more_steps[layer];
  ivec3 place_and_scale = ivec3(word(item, 0), word(item, 1), word(item, 2));
  vec3 mean = vec3(place_and_scale >> 8) * sizes.x;
  vec3 a = vec3((place_and_scale << 24) >> 24);
  vec3 turn = vec3(code_of(item, 0), code_of(item, 1), code_of(item, 2)) * sizes.w;
  vec4 quat = vec4(sqrt(max(1.0 - dot(turn, turn), 0.0)), turn);
  float opacity = float(code_of(item, 3 + 3 * K) & 255) / more.y;
#if K >= 4
  vec3 first = rgb(item, 1, more.x), second = rgb(item, 2, more.x), third = rgb(item, 3, more.x);
#else
  vec3 first = vec3(0.0), second = vec3(0.0), third = vec3(0.0);
#endif
  finish(place & 0xffffffu, gl_VertexID % TEXELS, mean, a * sizes.y + sizes.z, quat, opacity,
         rgb(item, 0, more.x), first, second, third);
}
`;

/** Gaussians as floats: slot, mean, log scales, quaternion, logit, harmonics. */
export const EXPAND_FLOATS = /* glsl */ `
uniform vec2 size_px;

${EXPANDED}

float number(int item, int n) {
  return uintBitsToFloat(word(item, n));
}

vec3 three(int item, int n) {
  return vec3(number(item, n), number(item, n + 1), number(item, n + 2));
}

void main() {
  int item = gl_VertexID / TEXELS;
  uint slot = floatBitsToUint(number(item, 0));
  vec4 quat = vec4(number(item, 7), three(item, 8));
  float opacity = 1.0 / (1.0 + exp(-number(item, 11)));
#if K >= 4
  vec3 first = three(item, 15), second = three(item, 18), third = three(item, 21);
#else
  vec3 first = vec3(0.0), second = vec3(0.0), third = vec3(0.0);
#endif
  finish(slot, gl_VertexID % TEXELS, three(item, 1), three(item, 4), quat, opacity,
         three(item, 12), first, second, third);
}
`;

export const STORE_TEXEL = /* glsl */ `
flat in uvec4 texel;
out uvec4 stored;

void main() {
  stored = texel;
}
`;

/** One Gaussian as one oriented quad; row 0 of the target is the top of the picture. */
export const SPLAT_VERTEX = /* glsl */ `
uniform usampler2D gaussians;
uniform mat3 rotation;      // world to camera
uniform vec3 translation;   // world to camera, metres
uniform vec3 position;      // of the camera in the world, metres
uniform vec2 focal_px;
uniform vec2 centre_px;
uniform vec2 limit;         // JACOBIAN_CLAMP * tan(fov / 2)
uniform vec2 size_px;
uniform float near_m;

in uint slot;               // one for each instance, farthest first

flat out vec2 splat_px;
flat out vec4 conic_opacity;
flat out vec3 colour;

vec4 texel(int n) {
  int column = (int(slot) % COLUMNS) * TEXELS + n;
  return uintBitsToFloat(texelFetch(gaussians, ivec2(column, int(slot) / COLUMNS), 0));
}

void main() {
  vec4 place = texel(0);
  vec4 cov_first = texel(1);
  vec4 cov_last = texel(2);
  vec4 rest = texel(3);
  mat3 cov = mat3(
    cov_first.x, cov_first.y, cov_first.z,
    cov_first.y, cov_first.w, cov_last.x,
    cov_first.z, cov_last.x, cov_last.y);

  vec3 seen = rotation * place.xyz + translation;
  vec2 ratio = seen.xy / seen.z;
  vec2 clamped = clamp(ratio, -limit, limit);
  vec2 scale = focal_px / seen.z;
  mat3 rows = transpose(rotation);
  vec3 a = scale.x * (rows[0] - clamped.x * rows[2]);
  vec3 b = scale.y * (rows[1] - clamped.y * rows[2]);
  vec3 cov_a = cov * a;
  vec3 cov_b = cov * b;
  float xx = dot(a, cov_a) + ${float(recipe.LOW_PASS_PX2)};
  float xy = dot(a, cov_b);
  float yy = dot(b, cov_b) + ${float(recipe.LOW_PASS_PX2)};
  float det = xx * yy - xy * xy;

  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);  // outside: nothing is drawn
  splat_px = focal_px * ratio + centre_px;
  conic_opacity = vec4(0.0);
  colour = vec3(0.0);
  // The order may be of a moment ago, when the camera looked elsewhere.
  if (!(det > 0.0) || seen.z <= near_m) return;

  conic_opacity = vec4(yy / det, -xy / det, xx / det, place.w);
  colour = vec3(cov_last.zw, rest.x);
#if TEXELS > 4
  vec4 more = texel(4);
  vec2 last = texel(5).xy;
  vec3 towards = normalize(place.xyz - position) * ${float(recipe.SH_C1)};
  colour += towards.z * more.xyz - towards.y * rest.yzw - towards.x * vec3(more.w, last);
#endif
  colour = max(colour, 0.0);

  // The axes of the ellipse on which alpha falls to ALPHA_MIN, a hair longer against rounding.
  float extent = 1.001 * min(${float(recipe.MAX_EXTENT_SIGMA)},
                             sqrt(2.0 * log(place.w / ${float(recipe.ALPHA_MIN)})));
  float middle = 0.5 * (xx + yy);
  float half_difference = 0.5 * (xx - yy);
  float spread = length(vec2(half_difference, xy));
  float long_variance = middle + spread;
  float short_variance = max(det / long_variance, 0.0);
  // Of the two expressions for the long axis, the one that does not cancel.
  vec2 axis = half_difference > 0.0 ? vec2(half_difference + spread, xy)
                                    : vec2(xy, spread - half_difference);
  axis = spread > 0.0 ? normalize(axis) : vec2(1.0, 0.0);
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  vec2 at_px = splat_px
    + extent * corner.x * sqrt(long_variance) * axis
    + extent * corner.y * sqrt(short_variance) * vec2(-axis.y, axis.x);
  gl_Position = vec4(2.0 * at_px / size_px - 1.0, 0.0, 1.0);
}
`;

export const SPLAT_FRAGMENT = /* glsl */ `
flat in vec2 splat_px;
flat in vec4 conic_opacity;
flat in vec3 colour;

out vec4 blended;           // premultiplied

void main() {
  // From the pixel's own centre, not from an interpolated offset: as exact as the CPU renderer.
  vec2 d = gl_FragCoord.xy - splat_px;
  float q = (0.5 * conic_opacity.x * d.x + conic_opacity.y * d.y) * d.x
    + 0.5 * conic_opacity.z * d.y * d.y;
  float alpha = min(${float(recipe.ALPHA_MAX)}, conic_opacity.w * exp(-q));
  if (alpha < ${float(recipe.ALPHA_MIN)}) discard;
  blended = vec4(alpha * colour, alpha);
}
`;

export const SCREEN_VERTEX = /* glsl */ `
void main() {
  // One triangle that covers everything.
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0;
  gl_Position = vec4(corner, 0.0, 1.0);
}
`;

/** Brings a finished picture onto a part of the screen: its row 0, the top, goes there to the top. */
export const SCREEN_FRAGMENT = /* glsl */ `
precision highp sampler2D;
uniform sampler2D picture;
uniform ivec2 corner_px;    // lower left of the part

out vec4 shown;

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy) - corner_px;
  at.y = textureSize(picture, 0).y - 1 - at.y;
  shown = vec4(texelFetch(picture, at, 0).rgb, 1.0);
}
`;
