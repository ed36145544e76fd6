/** Changes the speed of sound without its pitch: WSOLA (Verhelst and Roelands, 1993). */

/** Half a window, and the search distance for a similar window around the nominal place, in samples. */
const HOP = 720;
const REACH = 480;
/** Every STRIDE-th sample is compared. */
const STRIDE = 4;

const RISE = Float32Array.from(
  { length: HOP },
  (_, n) => Math.sin((Math.PI * (n + 0.5)) / 2 / HOP) ** 2,
);

/**
 * The sound stretched to `length` samples. Its beginning and end are those of the original, so that pieces
 * join without a break.
 * @param {Float32Array[]} channels
 * @param {number} length
 * @returns {Float32Array[]}
 */
export function stretched(channels, length) {
  const given = channels[0].length;
  const made = channels.map(() => new Float32Array(length));
  const last = length - 2 * HOP;
  if (last <= 0 || given < 2 * HOP) return channels.map((channel) => resampled(channel, length));
  const mono = mixed(channels);
  let from = 0;
  copy(channels, made, 0, 0, HOP);
  for (let at = HOP; at < length; at += HOP) {
    // Cross-fades from the samples that would follow to a similar window near the nominal place; the last
    // window is the original's end.
    const isLast = at >= last;
    const follows = from + HOP;
    const end = given - (length - at);
    const place = Math.round((at * given) / length);
    const to = isLast ? end : alike(mono, follows, place);
    const many = Math.min(HOP, length - at);
    for (const [n, channel] of channels.entries()) {
      for (let i = 0; i < many; i++) {
        const before = channel[follows + i] ?? 0;
        made[n][at + i] = before + RISE[i] * ((channel[to + i] ?? 0) - before);
      }
    }
    from = to;
    if (isLast) {
      copy(channels, made, to + many, at + many, length - at - many);
      break;
    }
  }
  return made;
}

/**
 * @param {Float32Array[]} channels
 * @param {Float32Array[]} made
 * @param {number} from
 * @param {number} at
 * @param {number} count
 */
function copy(channels, made, from, at, count) {
  for (const [n, channel] of channels.entries())
    made[n].set(channel.subarray(from, from + count), at);
}

/**
 * A mono mix for comparisons. The second channel has less weight, so that opposite channels do not cancel.
 * @param {Float32Array[]} channels
 */
function mixed([first, second]) {
  return second === undefined ? first : first.map((sample, n) => sample + 0.6 * second[n]);
}

/**
 * The start near `place` of the samples that are most similar to those at `follows`.
 * @param {Float32Array} mono
 * @param {number} follows
 * @param {number} place
 */
function alike(mono, follows, place) {
  const most = mono.length - 2 * HOP;
  const low = Math.max(0, Math.min(most, place - REACH));
  const high = Math.max(0, Math.min(most, place + REACH));
  if (follows + HOP > mono.length) return Math.max(0, Math.min(most, place));
  let best = low;
  let bestScore = -Infinity;
  for (let to = low; to <= high; to += STRIDE) {
    let product = 0;
    let energy = 1e-9;
    for (let i = 0; i < HOP; i += STRIDE) {
      product += mono[follows + i] * mono[to + i];
      energy += mono[to + i] ** 2;
    }
    const score = product / Math.sqrt(energy);
    if (score > bestScore) [best, bestScore] = [to, score];
  }
  return best;
}

/**
 * Plain resampling, for sound shorter than a window; it changes the pitch.
 * @param {Float32Array} channel
 * @param {number} length
 */
function resampled(channel, length) {
  return Float32Array.from({ length }, (_, n) => {
    const at = (n * channel.length) / length;
    const before = channel[Math.floor(at)];
    const after = channel[Math.min(channel.length - 1, Math.floor(at) + 1)];
    return before + (at % 1) * (after - before);
  });
}
