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
