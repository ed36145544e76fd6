// Puts the keys of each block where they go, those of equal digits in the order in which they are.

layout(local_size_x = THREADS) in;

layout(std430, binding = 2) readonly buffer Command { uint command[]; };
layout(std430, binding = 3) readonly buffer Tallies { uint tallies[]; };
layout(std430, binding = 4) readonly buffer Keys { uint keys[]; };
layout(std430, binding = 5) readonly buffer Slots { uint slots[]; };
layout(std430, binding = 6) writeonly buffer SortedKeys { uint sorted_keys[]; };
layout(std430, binding = 7) writeonly buffer SortedSlots { uint sorted_slots[]; };

uniform int digit;

const int BLOCK = THREADS * RUN;
const int DIGITS = 1 << DIGIT_BITS;

// How many keys of a digit the threads before this one have, digit after digit.
shared uint before[DIGITS * THREADS];

void main() {
    int total = digit == 0 ? SLOTS : int(command[1]);
    int groups = (total + BLOCK - 1) / BLOCK;
    int group = int(gl_WorkGroupID.x), thread = int(gl_LocalInvocationID.x);
    if (group >= groups) return;

    for (int d = 0; d < DIGITS; d++) before[d * THREADS + thread] = 0u;
    uint run[RUN];
    int first = group * BLOCK + thread * RUN;
    for (int i = 0; i < RUN; i++) {
        run[i] = first + i < total ? keys[first + i] : ABSENT;
        if (run[i] == ABSENT) continue;
        before[bitfieldExtract(run[i], DIGIT_BITS * digit, DIGIT_BITS) * THREADS + thread] += 1u;
    }
    sync();
    // Prefix sums over the threads, of all digits at once.
    for (int step = 1; step < THREADS; step *= 2) {
        uint others[DIGITS];
        for (int d = 0; d < DIGITS; d++) {
            others[d] = thread >= step ? before[d * THREADS + thread - step] : 0u;
        }
        sync();
        for (int d = 0; d < DIGITS; d++) before[d * THREADS + thread] += others[d];
        sync();
    }
    uint place[DIGITS];
    for (int d = 0; d < DIGITS; d++) {
        uint earlier = thread > 0 ? before[d * THREADS + thread - 1] : 0u;
        place[d] = tallies[d * groups + group] + earlier;
    }
    for (int i = 0; i < RUN; i++) {
        if (run[i] == ABSENT) continue;
        uint d = bitfieldExtract(run[i], DIGIT_BITS * digit, DIGIT_BITS);
        sorted_keys[place[d]] = run[i];
        sorted_slots[place[d]] = slots[first + i];
        place[d] += 1u;
    }
}
