/** A run of sound, whose speed changes without its pitch: WSOLA (Verhelst and Roelands, 1993). */

import { SAMPLE_RATE } from "../constants.js";

/** Half a window, and the search distance for a similar window around the nominal place, in samples. */
const HOP = 720;
const REACH = 480;
/** Every STRIDE-th sample is compared. */
const STRIDE = 4;

const RISE = new Float32Array(HOP).map((_, n) => Math.sin((Math.PI * (n + 0.5)) / 2 / HOP) ** 2);

/**
 * The sound stretched to `length` samples. Its beginning and end are those of the original, so that pieces
 * join without a break.
 * @param {Float32Array[]} channels @param {number} length @returns {Float32Array[]}
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
 * @param {Float32Array[]} channels @param {Float32Array[]} made @param {number} from @param {number} at
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
 * @param {Float32Array} mono @param {number} follows @param {number} place
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
 * @param {Float32Array} channel @param {number} length
 */
function resampled(channel, length) {
  return new Float32Array(length).map((_, n) => {
    const at = (n * channel.length) / length;
    const before = channel[Math.floor(at)];
    const after = channel[Math.min(channel.length - 1, Math.floor(at) + 1)];
    return before + (at % 1) * (after - before);
  });
}

/** Pieces are passed to the device this far ahead. */
const AHEAD_S = 1;
/** Delay before new sound begins, because the device itself works ahead. */
const SOON_S = 0.02;
const FADE_S = 0.01;
/** The pitch is kept between these speeds; others are silent. */
const LEAST_RATE = 0.25;
const MOST_RATE = 2;
/** At other speeds than 1, pieces are stretched in parts of this length, so as not to block the page. */
const PART_S = 0.25;

/** @typedef {import("./soundtrack.js").SoundTrack} SoundTrack */

/**
 * @typedef {object} Voice
 * @property {SoundTrack} track @property {GainNode} gain
 * @property {Set<AudioBufferSourceNode>} nodes the started ones
 * @property {number} next the first sample that was not passed to the device
 * @property {boolean} hasBegun whether the sample before `next` was passed to the device
 */

/**
 * Sound from one start to the next seek, pause or stall: schedules samples on the context's clock.
 * Samples are counted continuously through the rounds of a loop.
 */
export class SoundRun {
  /** Number of pieces after the first one that were missing when they were due. */
  gaps = 0;
  /** @type {Voice[]} */
  #voices;
  /** The last round; Infinity while the stream loops. */
  #lastRound = Infinity;
  /** Time of the last step, by the context's clock. */
  #steppedS = 0;

  /**
   * @param {BaseAudioContext} context @param {import("./timeline.js").Timeline} timeline
   * @param {[SoundTrack, AudioNode][]} outputs each track with its destination
   * @param {number} zeroS when sample 0 is or was due, by the context's clock @param {number} rate
   */
  constructor(context, timeline, outputs, zeroS, rate) {
    /** @type {BaseAudioContext} */ this.context = context;
    this.timeline = timeline;
    /** @type {number} */ this.rate = rate;
    /** @type {number} */ this.zero = Math.round(zeroS * SAMPLE_RATE);
    this.#steppedS = context.currentTime;
    const next = this.#sampleAt(context.currentTime + SOON_S);
    this.#voices = outputs.map(([track, output]) => {
      const gain = context.createGain();
      gain.gain.setValueAtTime(0, context.currentTime);
      gain.gain.setTargetAtTime(1, context.currentTime + SOON_S, FADE_S / 3);
      gain.connect(output);
      return { track, gain, nodes: new Set(), next, hasBegun: false };
    });
  }

  /** When sample 0 is or was due, by the context's clock. */
  get zeroS() {
    return this.zero / SAMPLE_RATE;
  }

  /** Converts a sample of the run to the device's sample. @param {number} sample */
  #deviceSample(sample) {
    return this.zero + Math.round(sample / this.rate);
  }

  /** @param {number} timeS by the context's clock */
  #sampleAt(timeS) {
    return Math.max(0, Math.round((timeS - this.zeroS) * this.rate * SAMPLE_RATE));
  }

  /** The round of a sample of the run. @param {number} sample */
  #roundOf(sample) {
    return Math.min(this.timeline.roundOf(sample), this.#lastRound);
  }

  /** The sample of the stream that is due now; beyond the stream's end after the last round. */
  get sample() {
    const sample = this.#sampleAt(this.context.currentTime);
    return sample - this.timeline.beginOf(this.#roundOf(sample));
  }

  /**
   * Sets whether the stream begins again after its end.
   * @param {boolean} loops @param {number} heardS time of the sound heard now, by the context's clock
   */
  setLoops(loops, heardS) {
    if (loops) this.#lastRound = Infinity;
    else if (this.#lastRound === Infinity)
      this.#endWith(this.timeline.roundOf(this.#sampleAt(heardS)));
  }

  /** Called when the pictures have reached the stream's end: scheduled sound of a next round is stopped. */
  end() {
    const now = this.#sampleAt(this.context.currentTime);
    this.#endWith(Math.max(1, Math.round(now / this.timeline.length)) - 1);
  }

  /** @param {number} round the last one */
  #endWith(round) {
    this.#lastRound = round;
    const seam = this.timeline.beginOf(round + 1);
    const seamS = this.#deviceSample(seam) / SAMPLE_RATE;
    for (const voice of this.#voices) {
      if (voice.next <= seam) continue;
      voice.next = seam;
      for (const node of voice.nodes) node.stop(Math.max(seamS, this.context.currentTime));
    }
  }

  /** Seconds of sound of all sources that the device already has. */
  get aheadS() {
    const next = Math.min(...this.#voices.map((voice) => voice.next));
    return this.#deviceSample(next) / SAMPLE_RATE - this.context.currentTime;
  }

  /** Passes sound that is due soon to the device. */
  step() {
    if (this.rate < LEAST_RATE || this.rate > MOST_RATE) return;
    const { context, timeline, rate } = this;
    const part = rate === 1 ? Infinity : Math.round(PART_S * rate * SAMPLE_RATE);
    // One part, plus the time since the last step: in a hidden page, steps are rare.
    const count = part + (context.currentTime - this.#steppedS) * rate * SAMPLE_RATE;
    this.#steppedS = context.currentTime;
    const least = this.#sampleAt(context.currentTime + SOON_S / 2);
    const most = this.#sampleAt(context.currentTime + AHEAD_S);
    for (const voice of this.#voices) {
      const enough = Math.min(most, Math.max(least, voice.next) + count);
      while (voice.next < enough) {
        const round = this.#roundOf(voice.next);
        const base = timeline.beginOf(round);
        if (voice.next - base >= timeline.length) {
          if (round >= this.#lastRound) break;
          voice.next = timeline.beginOf(round + 1);
          continue;
        }
        const at = voice.next - base;
        const { begin, end: pieceEnd } = timeline.pieceAt(at);
        const end = pieceEnd - at < 1.5 * part ? pieceEnd : at + part; // avoids tiny last parts
        const channels = voice.track.samples(begin);
        if (voice.next < least) {
          if (voice.hasBegun) this.gaps += 1;
          voice.hasBegun = false;
          voice.next = this.#sampleAt(context.currentTime + SOON_S);
          continue;
        }
        if (channels === null) break;
        this.#start(voice, channels, at - begin, base + end);
        voice.next = base + end;
        voice.hasBegun = true;
      }
    }
  }

  /**
   * @param {Voice} voice @param {Float32Array[]} channels of a piece
   * @param {number} from first sample within the piece @param {number} end end within the run
   */
  #start(voice, channels, from, end) {
    const { context } = this;
    const at = this.#deviceSample(voice.next);
    const length = this.#deviceSample(end) - at;
    if (length <= 0) return;
    const to = from + end - voice.next;
    const given = channels.map((channel) => channel.subarray(from, to));
    const heard = length === given[0].length ? given : stretched(given, length);
    const buffer = context.createBuffer(heard.length, length, SAMPLE_RATE);
    for (const [n, channel] of heard.entries())
      buffer.copyToChannel(/** @type {Float32Array<ArrayBuffer>} */ (channel), n);
    const node = context.createBufferSource();
    node.buffer = buffer;
    node.connect(voice.gain);
    node.onended = () => {
      voice.nodes.delete(node);
      node.disconnect();
    };
    voice.nodes.add(node);
    node.start(at / SAMPLE_RATE);
  }

  /** Fades out and ends the run. */
  stop() {
    const { currentTime } = this.context;
    for (const { gain, nodes } of this.#voices) {
      gain.gain.cancelScheduledValues(currentTime);
      gain.gain.setTargetAtTime(0, currentTime, FADE_S / 3);
      for (const node of nodes) node.stop(currentTime + 2 * FADE_S);
      setTimeout(() => gain.disconnect(), 1000);
    }
  }
}
