// Expands uploaded Gaussians: stores one texel per point. Those of a lattice if LATTICE is defined.
//
// It makes the texels of a Gaussian from its attributes: mean 3, opacity, covariance 6, colour 3, then the
// harmonics from degree 1 on. Every texel is one point; all points of a Gaussian do the same work.

#ifdef VERTEX_STAGE

uniform usampler2D staged;
uniform vec2 size_px;
uniform uvec2 saved;    // serial number of the update, place of its first item among the saved ones

flat out uvec4 texel;

uint word(int item, int n) {
  int at = item * ITEM_WORDS + n;
  return texelFetch(staged, ivec2(at / 4 % STAGED_WIDTH_PX, at / 4 / STAGED_WIDTH_PX), 0)[at % 4];
}

// Coefficient k, RGB, of the harmonics of an item.
vec3 coefficient(int item, int k);

void finish(int item, uint place, int n, vec3 mean, vec3 log_scales, vec4 quat, float opacity) {
  vec4 q = quat / length(quat);
  mat3 turned = mat3(
    1.0 - 2.0 * (q.z * q.z + q.w * q.w), 2.0 * (q.y * q.z + q.x * q.w), 2.0 * (q.y * q.w - q.x * q.z),
    2.0 * (q.y * q.z - q.x * q.w), 1.0 - 2.0 * (q.y * q.y + q.w * q.w), 2.0 * (q.z * q.w + q.x * q.y),
    2.0 * (q.y * q.w + q.x * q.z), 2.0 * (q.z * q.w - q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z));
  vec3 scales = exp(log_scales);
  mat3 stretched = mat3(turned[0] * scales.x, turned[1] * scales.y, turned[2] * scales.z);
  mat3 cov = stretched * transpose(stretched);
  vec4 found = vec4(0.0);
  if (n == 0) found = vec4(mean, opacity);
  else if (n == 1) found = vec4(cov[0][0], cov[0][1], cov[0][2], cov[1][1]);
  else {
    if (n == 2) found.xy = vec2(cov[1][2], cov[2][2]);
    // The colour begins at word 10.
    for (int i = n == 2 ? 2 : 0; i < 4; i++) {
      int at = 4 * n + i - 10, k = at / 3;
      if (k >= K) break;
      float value = coefficient(item, k)[at % 3];
      found[i] = k == 0 ? 0.5 + SH_C0 * value : value;
    }
  }
  texel = floatBitsToUint(found);
  // Two words that no attribute uses: the update, the place of the saved state, and the move.
  if (n == TEXELS - 1) texel.zw = uvec2(saved.x, (saved.y + uint(item)) << 2 | place >> 28);
  uint slot = place & 0xffffffu;
  ivec2 at = ivec2((int(slot) % COLUMNS) * TEXELS + n, int(slot) / COLUMNS);
  gl_Position = vec4((vec2(at) + 0.5) / size_px * 2.0 - 1.0, 0.0, 1.0);
  gl_PointSize = 1.0;
}

#else

flat in uvec4 texel;
out uvec4 stored;

void main() {
  stored = texel;
}

#endif

#ifdef VERTEX_STAGE
#ifdef LATTICE

// Gaussians on a lattice: three position coordinates of 24 bits, each followed by a log scale; slot, layer
// and move in 24, 4 and 4 bits; then the other attributes, one byte each.

uniform vec4 steps[16];         // of each layer: position, log scale, log scale's base, rotation
uniform vec2 more_steps[16];    // colour, opacity levels - 1

int code_of(int item, int i) {
  return int(word(item, 4 + i / 4) << (24 - 8 * (i % 4))) >> 24;
}

vec3 coefficient(int item, int c) {
  float size = more_steps[int(word(item, 3) >> 24) & 15].x;
  float y = float(code_of(item, 3 + c)) * size;
  float co = float(code_of(item, 3 + K + c)) * size;
  float cg = float(code_of(item, 3 + 2 * K + c)) * size;
  return vec3(y - cg + co, y + cg, y - cg - co);
}

void main() {
  int item = gl_VertexID / TEXELS;
  uint place = word(item, 3);
  int layer = int(place >> 24) & 15;
  vec4 sizes = steps[layer];
  vec2 more = more_steps[layer];
  ivec3 place_and_scale = ivec3(word(item, 0), word(item, 1), word(item, 2));
  vec3 mean = vec3(place_and_scale >> 8) * sizes.x;
  vec3 a = vec3((place_and_scale << 24) >> 24);
  vec3 turn = vec3(code_of(item, 0), code_of(item, 1), code_of(item, 2)) * sizes.w;
  vec4 quat = vec4(sqrt(max(1.0 - dot(turn, turn), 0.0)), turn);
  float opacity = float(code_of(item, 3 + 3 * K) & 255) / more.y;
  finish(item, place, gl_VertexID % TEXELS, mean, a * sizes.y + sizes.z, quat, opacity);
}

#else

// Gaussians as floats: slot and move, mean, log scales, quaternion, logit, harmonics.

float number(int item, int n) {
  return uintBitsToFloat(word(item, n));
}

vec3 three(int item, int n) {
  return vec3(number(item, n), number(item, n + 1), number(item, n + 2));
}

vec3 coefficient(int item, int k) {
  return three(item, 12 + 3 * k);
}

void main() {
  int item = gl_VertexID / TEXELS;
  vec4 quat = vec4(number(item, 7), three(item, 8));
  float opacity = 1.0 / (1.0 + exp(-number(item, 11)));
  finish(item, word(item, 0), gl_VertexID % TEXELS, three(item, 1), three(item, 4), quat, opacity);
}

#endif
#endif
