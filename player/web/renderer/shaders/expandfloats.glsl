// Gaussians as floats: slot and move, mean, log scales, quaternion, logit, harmonics. Behind expand.glsl.

#ifdef VERTEX_STAGE

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
