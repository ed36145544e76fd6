// Turns the counts of all blocks into the places where each block's keys of each digit go.

layout(local_size_x = SCAN_THREADS) in;

layout(std430, binding = 2) buffer Command { uint command[]; };
layout(std430, binding = 3) buffer Tallies { uint tallies[]; };

uniform int digit;

const int BLOCK = THREADS * RUN;
const int DIGITS = 1 << DIGIT_BITS;

shared uint sums[SCAN_THREADS];

void main() {
    int total = digit == 0 ? SLOTS : int(command[1]);
    int entries = (total + BLOCK - 1) / BLOCK * DIGITS;
    int thread = int(gl_LocalInvocationID.x);
    int share = (entries + SCAN_THREADS - 1) / SCAN_THREADS;
    int first = min(thread * share, entries), end = min(first + share, entries);
    uint sum = 0u;
    for (int i = first; i < end; i++) sum += tallies[i];
    sums[thread] = sum;
    sync();
    for (int step = 1; step < SCAN_THREADS; step *= 2) {
        uint before = thread >= step ? sums[thread - step] : 0u;
        sync();
        sums[thread] += before;
        sync();
    }
    uint place = sums[thread] - sum;
    for (int i = first; i < end; i++) {
        uint count = tallies[i];
        tallies[i] = place;
        place += count;
    }
    // The first pass leaves out what is absent.
    if (digit == 0 && thread == SCAN_THREADS - 1) command[1] = sums[thread];
}
