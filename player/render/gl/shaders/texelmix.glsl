// Texels of Gaussians from one texture to another: TEXELS points for each instance, a Gaussian. With
// MIXES, what the newest slice changes goes to its place at a share of its way from where it was (see
// mix.glsl), or to the spare slot where it fades out. Else the Gaussians of some slots are set aside.

#ifdef VERTEX_STAGE

uniform vec2 size_px;           // of the target
#ifdef MIXES
uniform usampler2D before;      // texels of the instances, one after another, SIDE_PX in a row
uniform usampler2D after;
uniform float share;            // 0..1

in uvec3 item;                  // slot to write to, how it moves, number of the Gaussian set aside
#else
uniform usampler2D gaussians;   // COLUMNS Gaussians in a row

in uint item;                   // slot to set aside
#endif

flat out uvec4 found;

ivec2 in_slots(int slot) {
    return ivec2((slot % COLUMNS) * TEXELS + gl_VertexID, slot / COLUMNS);
}

ivec2 aside(int number) {
    int at = number * TEXELS + gl_VertexID;
    return ivec2(at % SIDE_PX, at / SIDE_PX);
}

void main() {
#ifdef MIXES
    int move = int(item.y), number = int(item.z);
    uvec4 first = texelFetch(before, aside(number), 0), last = texelFetch(after, aside(number), 0);
    if (move == ENTERS) first = last;
    if (move == LEAVES) last = first;
    vec4 mixed = mix(uintBitsToFloat(first), uintBitsToFloat(last), share);
    if (gl_VertexID == 0) {
        if (move == ENTERS) mixed.w *= share;
        if (move == LEAVES) mixed.w *= 1.0 - share;
    }
    found = share < 1.0 ? floatBitsToUint(mixed) : last;
    ivec2 there = in_slots(int(item.x));
#else
    found = texelFetch(gaussians, in_slots(int(item)), 0);
    ivec2 there = aside(gl_InstanceID);
#endif
    gl_Position = vec4(2.0 * (vec2(there) + 0.5) / size_px - 1.0, 0.0, 1.0);
    gl_PointSize = 1.0;
}

#else

flat in uvec4 found;

out uvec4 stored;

void main() {
    stored = found;
}

#endif
