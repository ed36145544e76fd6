// Which Gaussians show, and how far away: one key for each slot.

layout(local_size_x = GROUP) in;

layout(std430, binding = 0) readonly buffer Gaussians { uvec4 gaussians[]; };
// First frame, the frame after the last, number of the last whole slice and of the last slice.
layout(std430, binding = 1) readonly buffer Lanes { ivec4 lanes[]; };
layout(std430, binding = 4) writeonly buffer Keys { uint keys[]; };

uniform int frame;
uniform float near_m;
uniform uint near_bits;     // of the float from which on depths are told apart

uniform mat3 rotation;
uniform vec3 translation;
uniform vec2 focal_px;
uniform vec2 centre_px;
uniform vec2 limit;
uniform vec2 size_px;

const int NEVER = 0x7fffffff;
const uint FARTHEST = (1u << KEY_BITS) - 1u;

// Whether the lane shows this Gaussian in `frame`. One of the last slice starts when that says; one
// that was kept is there from its lane's first frame on; what an earlier whole slice left behind it
// is not part of the lane any more.
bool shows(ivec4 lane, int start, int serial) {
    if (frame < lane.x || frame >= lane.y || serial < lane.z) return false;
    return serial == lane.w ? start <= frame : start != NEVER;
}

uint key_of(int slot) {
    int at = slot * TEXELS;
    ivec2 when = ivec2(gaussians[at + TEXELS - 1].zw);
    if (!shows(lanes[slot / LANE_SLOTS], when.x, when.y)) return ABSENT;

    vec4 place = uintBitsToFloat(gaussians[at]);
    vec3 seen = rotation * place.xyz + translation;
    if (!(seen.z > near_m)) return ABSENT;

    // Not less than the variance along any line, so the quad lies within this box.
    vec4 cov_first = uintBitsToFloat(gaussians[at + 1]);
    float variance = cov_first.x + cov_first.w + uintBitsToFloat(gaussians[at + 2]).y;
    vec2 ratio = seen.xy / seen.z;
    vec2 clamped = clamp(ratio, -limit, limit);
    vec2 scale = focal_px / seen.z;
    vec2 half_px = 1.01 * MAX_EXTENT_SIGMA
        * sqrt(scale * scale * (1.0 + clamped * clamped) * variance + LOW_PASS_PX2);
    vec2 at_px = focal_px * ratio + centre_px;
    // Written so that what is not a number is kept, as it is where nobody looks at the box.
    if (any(lessThan(at_px + half_px, vec2(0.0))) || any(greaterThan(at_px - half_px, size_px))) {
        return ABSENT;
    }
    uint bits = floatBitsToUint(seen.z);
    return FARTHEST - min(bits - min(bits, near_bits), FARTHEST);
}

void main() {
    int slot = int(gl_GlobalInvocationID.x);
    if (slot < SLOTS) keys[slot] = key_of(slot);
}
