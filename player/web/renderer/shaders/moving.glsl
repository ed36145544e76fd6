#ifdef MOVING

// Before the splat shader: mixes Gaussians changed by the newest update with their saved state.

#ifdef VERTEX_STAGE

uniform usampler2D before;  // SAVED texels for each Gaussian, COLUMNS of them in a row
uniform uint serial;        // of the newest update
uniform float share;        // progress of the motion, 0..1

int number = -1;            // index of this Gaussian's saved state; -1: none
float back = 0.0;           // weight of the saved state
float fade = 1.0;

void set_out(int slot, uvec2 came) {
  if (slot >= NUM_SLOTS) {
    number = slot - NUM_SLOTS;
    back = 1.0;
    fade = 1.0 - share;
  } else if (came.x == serial && share < 1.0) {
    int move = int(came.y) & 3;
    if (move == ENTERS) fade = share;
    if (move == MOVES) {
      number = int(came.y >> 2);
      back = 1.0 - share;
    }
  }
}

vec4 saved(int n) {
  ivec2 at = ivec2(number % COLUMNS * SAVED + n, number / COLUMNS);
  return uintBitsToFloat(texelFetch(before, at, 0));
}

vec4 on_its_way(vec4 there, int n) {
  if (number >= 0) there = back < 1.0 ? mix(there, saved(n), back) : saved(n);
  if (n == 0) there.w *= fade;
  return there;
}

vec3 colour_on_its_way(vec3 there) {
  if (number < 0) return there;
  vec3 was = vec3(saved(2).zw, saved(3).x);
  return back < 1.0 ? mix(there, was, back) : was;
}

#endif

#else

// Saves the state of some slots. With harmonics of degree 2 or more, the constant colour is replaced by the
// colour as last seen.

#ifdef VERTEX_STAGE

uniform usampler2D staged;      // items that name the slots
uniform usampler2D gaussians;
uniform usampler2D colours;
uniform vec2 size_px;
uniform ivec3 items;            // words of each, index of the word with the slot, place of the first

flat out uvec4 texel;

void main() {
  int item = gl_VertexID / SAVED, n = gl_VertexID % SAVED;
  int word = item * items.x + items.y;
  uvec4 named = texelFetch(staged, ivec2(word / 4 % STAGED_WIDTH_PX, word / 4 / STAGED_WIDTH_PX), 0);
  int slot = int(named[word % 4] & 0xffffffu);
  texel = texelFetch(gaussians, ivec2(slot % COLUMNS * TEXELS + n, slot / COLUMNS), 0);
#if SH_DEGREE >= 2
  uvec4 seen = texelFetch(colours, ivec2(slot % COLOUR_COLUMNS, slot / COLOUR_COLUMNS), 0);
  if (n == 2) texel.zw = seen.xy;
  if (n == 3) texel.x = seen.z;
#endif
  int number = items.z + item;
  vec2 at = vec2(number % COLUMNS * SAVED + n, number / COLUMNS);
  gl_Position = vec4((at + 0.5) / size_px * 2.0 - 1.0, 0.0, 1.0);
  gl_PointSize = 1.0;
}

#else

flat in uvec4 texel;
out uvec4 stored;

void main() {
  stored = texel;
}

#endif

#endif
