// How many keys of each digit lie in each block.

layout(local_size_x = THREADS) in;

layout(std430, binding = 2) readonly buffer Command { uint command[]; };
layout(std430, binding = 3) writeonly buffer Tallies { uint tallies[]; };  // digit after digit
layout(std430, binding = 4) readonly buffer Keys { uint keys[]; };

uniform int digit;

const int BLOCK = THREADS * RUN;
const int DIGITS = 1 << DIGIT_BITS;

shared uint counts[DIGITS];

void main() {
    int total = digit == 0 ? SLOTS : int(command[1]);
    int groups = (total + BLOCK - 1) / BLOCK;
    int group = int(gl_WorkGroupID.x), thread = int(gl_LocalInvocationID.x);
    if (group >= groups) return;
    if (thread < DIGITS) counts[thread] = 0u;
    sync();
    for (int i = 0; i < RUN; i++) {
        int at = group * BLOCK + i * THREADS + thread;
        if (at >= total) break;
        uint key = keys[at];
        // A sum is the same in whichever order it is made.
        if (key != ABSENT) atomicAdd(counts[bitfieldExtract(key, DIGIT_BITS * digit, DIGIT_BITS)], 1u);
    }
    sync();
    if (thread < DIGITS) tallies[thread * groups + group] = counts[thread];
}
