/** Windows after which a sample goes, however few bytes have come since. */
const MANY_WINDOWS = 20;

/**
 * What an estimator takes for a sample and how long it keeps one; server/abr/estimator.py says why.
 * @typedef {object} EstimatorConfig
 * @property {number} windowS seconds that the estimate looks back
 * @property {number} sampleS busy seconds gathered into one sample
 * @property {number} minBytes that an estimate goes by at least
 */

/** @type {EstimatorConfig} */
export const ESTIMATOR_CONFIG = { windowS: 0.4, sampleS: 0.02, minBytes: 16 * 1024 };

/**
 * @typedef {object} Sample
 * @property {number} bytes
 * @property {number} busyS
 * @property {number} idleS
 */

/** How fast a connection carries bytes: bytes over busy time, within a short window. */
export class RateEstimator {
  /** @param {EstimatorConfig} config */
  constructor(config = ESTIMATOR_CONFIG) {
    this.config = config;
    /** @type {number | null} bits per second; null until enough has come */
    this.rateBps = null;
    /** @type {Sample[]} */
    this.samples = [];
    /** @type {Sample} */
    this.sum = { bytes: 0, busyS: 0, idleS: 0 };
    /** @type {Sample} */
    this.open = { bytes: 0, busyS: 0, idleS: 0 };
  }

  /**
   * Takes in that bytes came during `busyS` seconds, after `idleS` of which nothing is known.
   * @param {number} bytes
   * @param {number} busyS
   * @param {number} idleS
   */
  add(bytes, busyS, idleS) {
    const { config, open, sum } = this;
    open.bytes += bytes;
    open.busyS += busyS;
    open.idleS += idleS;
    if (open.bytes < config.minBytes && open.busyS < config.sampleS) return;
    this.samples.push(open);
    sum.bytes += open.bytes;
    sum.busyS += open.busyS;
    sum.idleS += open.idleS;
    this.open = { bytes: 0, busyS: 0, idleS: 0 };
    while (this.#isEnoughWithoutTheFirst()) {
      const [old] = this.samples.splice(0, 1);
      sum.bytes -= old.bytes;
      sum.busyS -= old.busyS;
      sum.idleS -= old.idleS;
    }
    const isKnown = sum.bytes >= config.minBytes || this.rateBps !== null;
    if (isKnown && sum.busyS > 0) this.rateBps = Math.max(1, (8 * sum.bytes) / sum.busyS);
  }

  #isEnoughWithoutTheFirst() {
    if (this.samples.length < 2) return false;
    const [first] = this.samples;
    const busyS = this.sum.busyS - first.busyS;
    if (busyS >= MANY_WINDOWS * this.config.windowS) return true;
    const spanS = busyS + (this.sum.idleS - first.idleS);
    return spanS >= this.config.windowS && this.sum.bytes - first.bytes >= this.config.minBytes;
  }
}
