/** Of the link that a layer is taken to need, at most: in an outage it would be any number. */
const MOST_SHARE = 100;

/** What our policy weighs; server/abr/policies/sweep.py says what each number means. */
export const SWEEP_CONFIG = {
  basePatienceS: 70,
  wholeShare: 0.5,
  patienceS: 0.4,
  safePatienceS: 1.2,
  spareShare: 0.1,
  memoryS: 10,
  leastPatienceS: 0.1,
  mostPatienceS: 3,
  leftShare: 0.1,
  stallDb: 60,
  holdS: 4,
  settleS: 0.5,
  safety: 0.9,
  leastLife: 0.5,
};

/** @typedef {typeof SWEEP_CONFIG} SweepConfig */

/** How long packets can wait, as a mean over the last seconds. */
export class Patience {
  /** @param {SweepConfig} config */
  constructor(config) {
    this.config = config;
    /** @type {[number, number] | null} */
    this.meanS = null;
    /** The least patience of layer 0 that has been paid for. */
    this.safeS = 0;
    this.atS = 0;
  }

  /**
   * Takes in what is estimated now; gives the patience of layer 0, and of the others.
   * @param {import("./outlook.js").Outlook} outlook
   * @returns {[number, number]}
   */
  note(outlook) {
    const { config } = this;
    const { media } = outlook;
    const { sliceBytes } = media.sizes(Math.min(outlook.nextFrame, media.numFrames - 1));
    const baseBps = 8 * media.fps * Math.max(1, sliceBytes[0]);
    const wholeBps = 8 * media.fps * Math.max(1, sliceBytes[sliceBytes.length - 1]);
    const ease = outlook.rateBps > wholeBps ? config.wholeShare : 1;
    let baseS = this.#bounded(ease * (config.basePatienceS * share(baseBps, outlook) ** 4));
    let upperS = this.#bounded(config.patienceS * share(wholeBps, outlook) ** 2);
    const mostS = config.leftShare * leftS(outlook);
    if (!outlook.measured) return [Math.min(mostS, baseS), Math.min(mostS, upperS)];
    if (this.meanS !== null) {
      const sinceS = outlook.nowS - this.atS;
      const kept = 0.5 ** (sinceS / config.memoryS);
      baseS += kept * (this.meanS[0] - baseS);
      upperS += kept * (this.meanS[1] - upperS);
      const spare = Math.max(0, outlook.rateBps - wholeBps) / baseBps;
      this.safeS = Math.min(config.safePatienceS, this.safeS + config.spareShare * spare * sinceS);
    }
    this.meanS = [baseS, upperS];
    this.atS = outlook.nowS;
    return [Math.min(mostS, Math.max(this.safeS, baseS)), Math.min(mostS, upperS)];
  }

  /** @param {number} patienceS */
  #bounded(patienceS) {
    return Math.min(this.config.mostPatienceS, Math.max(this.config.leastPatienceS, patienceS));
  }
}

/**
 * @param {number} needBps
 * @param {import("./outlook.js").Outlook} outlook
 */
function share(needBps, outlook) {
  return Math.min(MOST_SHARE, needBps / outlook.rateBps);
}

/**
 * What is left to play; without end where that is not known.
 * @param {import("./outlook.js").Outlook} outlook
 */
function leftS(outlook) {
  const { untilFrame } = outlook.clock;
  return untilFrame === null ? Infinity : (untilFrame - outlook.nextFrame) / outlook.media.fps;
}
