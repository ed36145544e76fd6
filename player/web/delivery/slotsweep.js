import { Patience, SWEEP_CONFIG } from "./patience.js";

/**
 * @typedef {object} Offer
 * @property {number} priority
 * @property {import("./outlook.js").Send} what
 */

/**
 * Our policy where slots last: the same weighing, of chains of changes
 * (server/abr/policies/slotsweep.py). A layer that is behind offers the cheapest way back.
 */
export class SlotSweep {
  mends = true;

  /** @param {import("./patience.js").SweepConfig} config */
  constructor(config = SWEEP_CONFIG) {
    this.config = config;
    this.patience = new Patience(config);
    /** @type {[number, number]} */
    this.patienceS = [0, 0];
  }

  /**
   * What to ask for now; null if nothing is worth it until something changes.
   * @param {import("./outlook.js").Outlook} outlook
   * @param {import("./slotholding.js").SlotHolding} holding
   * @returns {import("./outlook.js").Send | null}
   */
  choose(outlook, holding) {
    const rateBps = this.config.safety * outlook.rateBps;
    this.patienceS = this.patience.note(outlook);
    const freeS = outlook.comesS(0, rateBps);
    /** @type {Offer | null} */
    let best = null;
    let end = outlook.endBirth;
    for (let layer = 0; layer < outlook.media.numLayers; layer++) {
      const offer = this.#offer(outlook, holding, layer, end, freeS, rateBps);
      if (offer !== null && (best === null || offer.priority > best.priority)) best = offer;
      // A layer is worth something where those before it are there.
      end = Math.min(end, holding.endBirth(layer) ?? 0);
    }
    return best === null ? null : best.what;
  }

  /**
   * The best that `layer` can be sent, of births before `end`.
   * @param {import("./outlook.js").Outlook} outlook
   * @param {import("./slotholding.js").SlotHolding} holding
   * @param {number} layer
   * @param {number} end
   * @param {number} freeS
   * @param {number} rateBps
   * @returns {Offer | null}
   */
  #offer(outlook, holding, layer, end, freeS, rateBps) {
    const { config } = this;
    const { media } = outlook;
    const birth = holding.endBirth(layer);
    if (layer === 0 && birth === null) {
      const first = media.segmentStart(outlook.clock.firstFrame);
      return { priority: Infinity, what: snapshots(first, 0) };
    }
    if (birth !== null) {
      if (birth >= end) return null;
      const sizes = media.sizes(birth);
      const size = sizes.layerBytes[layer];
      const slackS = outlook.dueS(birth) - freeS - (8 * size) / rateBps;
      if (layer === 0 || slackS > -0.5 / media.fps) {
        const gainDb = layer ? sizes.gainsDb[layer] : config.stallDb;
        const urgency = Math.exp(-Math.max(0, slackS) / this.patienceS[Math.min(layer, 1)]);
        return {
          priority: (gainDb / Math.max(size, 1)) * urgency,
          what: slices(birth, Math.min(end, birth + outlook.runLength(size, rateBps)), layer),
        };
      }
    }
    return this.#wayBack(outlook, layer, birth, end, freeS, rateBps);
  }

  /**
   * The best way to bring a layer up to date that is behind or not there.
   * @param {import("./outlook.js").Outlook} outlook
   * @param {number} layer
   * @param {number | null} birth
   * @param {number} end
   * @param {number} freeS
   * @param {number} rateBps
   * @returns {Offer | null}
   */
  #wayBack(outlook, layer, birth, end, freeS, rateBps) {
    const { config } = this;
    const { media } = outlook;
    const { fps } = media;
    // The frame that shows when what is asked for now arrives.
    const late = Math.max(0, (freeS - outlook.dueS(outlook.nextFrame)) * fps);
    const frame = Math.min(outlook.nextFrame + late, media.numFrames - 1);
    const sizes = media.sizes(Math.trunc(frame));
    const size = Math.max(1, sizes.layerBytes[layer]);
    const gainDb = sizes.gainsDb[layer];
    const needBps = 8 * fps * sizes.sliceBytes[layer];
    let { holdS } = config;
    if (needBps > rateBps) {
      // It lasts for as long as the leads of the layers before it do.
      holdS = Math.min(holdS, (((end - frame) / fps) * rateBps) / (needBps - rateBps));
    }
    holdS -= config.settleS;
    if (holdS <= 0 || gainDb <= 0) return null;
    const frames = holdS * fps;
    const patienceS = this.patienceS[Math.min(layer, 1)];
    const worth = (/** @type {number} */ costBytes, /** @type {number} */ slackS) =>
      ((gainDb * frames) / (costBytes + (frames + config.settleS * fps) * size)) *
      Math.exp(-Math.max(0, slackS) / patienceS);
    /** @type {Offer[]} */
    const offers = [];
    // While missed changes are sent, more are missed.
    const ahead = 1 - (8 * fps * size) / rateBps;
    const first = media.segmentStart(Math.trunc(frame));
    if (ahead > 0.05) {
      if (birth !== null && birth < end) {
        const endBirth = Math.min(end, birth + outlook.runLength(size, rateBps));
        const priority = worth(((frame - birth) * size) / ahead, 0);
        offers.push({ priority, what: slices(birth, endBirth, layer) });
      }
      if (first < end && (birth === null || first > birth)) {
        const cost = (sizes.snapshotBytes[layer] + (frame - first) * size) / ahead;
        offers.push({ priority: worth(cost, 0), what: snapshots(first, layer) });
      }
    }
    for (const later of [first + media.segmentFrames, first + 2 * media.segmentFrames]) {
      if (later >= end) break;
      const cost = media.sizes(later).snapshotBytes[layer];
      const slackS = outlook.dueS(later) - freeS - (8 * cost) / rateBps;
      if (slackS >= 0) {
        offers.push({ priority: worth(cost, slackS), what: snapshots(later, layer) });
        break;
      }
    }
    /** @type {Offer | null} */
    let best = null;
    for (const offer of offers) if (best === null || offer.priority > best.priority) best = offer;
    return best;
  }
}

/**
 * @param {number} birth
 * @param {number} endBirth
 * @param {number} layer
 * @returns {import("./outlook.js").Send}
 */
function slices(birth, endBirth, layer) {
  return { kind: "slices", birth, endBirth, firstLayer: layer, endLayer: layer + 1 };
}

/**
 * @param {number} frame
 * @param {number} layer
 * @returns {import("./outlook.js").Send}
 */
function snapshots(frame, layer) {
  return { kind: "snapshots", frame, firstLayer: layer, endLayer: layer + 1 };
}
