// Brings Gaussians that change to their rows of a lane, and keeps those before them.

layout(local_size_x = GROUP) in;

layout(std430, binding = 0) buffer Gaussians { uvec4 gaussians[]; };
layout(std430, binding = 2) readonly buffer Rows { int rows[]; };
layout(std430, binding = 3) readonly buffer Changed { uvec4 changed[]; };

layout(std430, binding = 6) writeonly buffer Before { uvec4 before[]; };

uniform int first_slot;     // of the lane
uniform int count;

void main() {
    int i = int(gl_GlobalInvocationID.x);
    if (i >= count) return;
    int at = (first_slot + rows[i]) * TEXELS;
    for (int n = 0; n < TEXELS; n++) {
        before[i * TEXELS + n] = gaussians[at + n];
        gaussians[at + n] = changed[i * TEXELS + n];
    }
}
