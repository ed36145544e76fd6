// Which Gaussians show, and how far away: a slot and its key for each place in the order that equally
// far ones keep: newest slice and last row first, as order.py has it.

layout(local_size_x = GROUP) in;

layout(std430, binding = 0) readonly buffer Gaussians { uvec4 gaussians[]; };
// First frame, the frame after the last, number of the last whole slice and of the last slice.
layout(std430, binding = 1) readonly buffer Lanes { ivec4 lanes[]; };
layout(std430, binding = 4) writeonly buffer Keys { uint keys[]; };
layout(std430, binding = 5) writeonly buffer Slots { uint slots[]; };

uniform int frame;
uniform int newest_lane;    // of the slice born at `frame`
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
    precise float depth = rotation[0].z * place.x + rotation[1].z * place.y;
    depth = depth + rotation[2].z * place.z;
    depth = depth + translation.z;
    if (!(depth > near_m)) return ABSENT;

    // Not less than the variance along any line, so the quad lies within this box.
    vec4 cov_first = uintBitsToFloat(gaussians[at + 1]);
    float variance = cov_first.x + cov_first.w + uintBitsToFloat(gaussians[at + 2]).y;
    vec2 ratio = seen.xy / depth;
    vec2 clamped = clamp(ratio, -limit, limit);
    vec2 scale = focal_px / depth;
    vec2 half_px = 1.01 * MAX_EXTENT_SIGMA
        * sqrt(scale * scale * (1.0 + clamped * clamped) * variance + LOW_PASS_PX2);
    vec2 at_px = focal_px * ratio + centre_px;
    // Written so that what is not a number is kept, as it is where nobody looks at the box.
    if (any(lessThan(at_px + half_px, vec2(0.0))) || any(greaterThan(at_px - half_px, size_px))) {
        return ABSENT;
    }
    uint bits = floatBitsToUint(depth);
    return FARTHEST - min(bits - min(bits, near_bits), FARTHEST);
}

void main() {
    int place = int(gl_GlobalInvocationID.x);
    if (place >= SLOTS) return;
    int age = place / LANE_SLOTS, row = LANE_SLOTS - 1 - place % LANE_SLOTS;
    int lane = newest_lane - age;
    if (lane < 0) lane += LANES;
    // Behind the lanes lie the spare slots, whose record is that of one more lane.
    int slot = age < LANES ? lane * LANE_SLOTS + row : place;
    keys[place] = key_of(slot);
    slots[place] = uint(slot);
}
