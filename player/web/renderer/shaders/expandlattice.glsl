// Gaussians on a lattice: three position coordinates of 24 bits, each followed by a log scale; slot, layer
// and move in 24, 4 and 4 bits; then the other attributes, one byte each. Behind expand.glsl.

#ifdef VERTEX_STAGE

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

#endif
