// Expands uploaded Gaussians: stores one texel per point. One of expandlattice.glsl and expandfloats.glsl follows.
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
