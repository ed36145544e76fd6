// Puts what the newest slice changes at a share of its way from where it was: positions, covariances,
// colours and opacities go along a straight line. What ends fades out in a spare slot.

layout(local_size_x = GROUP) in;

layout(std430, binding = 0) writeonly buffer Gaussians { uvec4 gaussians[]; };
layout(std430, binding = 2) readonly buffer Rows { int rows[]; };
layout(std430, binding = 3) readonly buffer Changed { uvec4 changed[]; };
layout(std430, binding = 6) readonly buffer Before { uvec4 before[]; };
layout(std430, binding = 7) readonly buffer Moves { int moves[]; };

uniform int first_slot;     // of the lane
uniform int count;
uniform float share;        // 0..1
uniform int frame;
uniform int serial;         // of the slice

const int NEVER = 0x7fffffff;

// Writes a Gaussian between two; one that is too faint to show has no first frame.
void put(int slot, int i, bool from_before, bool to_changed, ivec2 when) {
    for (int n = 0; n < TEXELS; n++) {
        uvec4 first = before[i * TEXELS + n], last = changed[i * TEXELS + n];
        if (!from_before) first = last;
        if (!to_changed) last = first;
        vec4 mixed = mix(uintBitsToFloat(first), uintBitsToFloat(last), share);
        if (n == 0) {
            if (!from_before) mixed.w *= share;
            if (!to_changed) mixed.w *= 1.0 - share;
            if (mixed.w < ALPHA_MIN) when.x = NEVER;
        }
        uvec4 words = floatBitsToUint(mixed);
        if (share >= 1.0) words = last;
        if (n == TEXELS - 1) words.zw = uvec2(when);
        gaussians[slot * TEXELS + n] = words;
    }
}

void main() {
    int i = int(gl_GlobalInvocationID.x);
    if (i >= count) return;
    int move = moves[i];
    ivec2 when = ivec2(changed[i * TEXELS + TEXELS - 1].zw);
    bool shows = when.x != NEVER;
    if ((move & (MOVES | ENTERS)) != 0 && shows)
        put(first_slot + rows[i], i, (move & MOVES) != 0, true, when);
    int spare = move >> LEAVING_AT;
    if (spare > 0 && share < 1.0)
        put(SPARE_SLOT + spare - 1, i, true, false, ivec2(frame, serial));
}
