import { Patience, SWEEP_CONFIG } from "./patience.js";

/**
 * Our policy for version 1: of all that is lacking, what is worth most per byte and cannot wait
 * (server/abr/policies/sweep.py).
 */
export class SliceSweep {
  mends = true;

  /** @param {import("./patience.js").SweepConfig} config */
  constructor(config = SWEEP_CONFIG) {
    this.config = config;
    this.patience = new Patience(config);
    /** @type {[number, number]} */
    this.patienceS = [0, 0];
    /** @type {number[] | null} of each layer a birth before which no slice lacks just this layer */
    this.next = null;
    /** @type {number[]} of each layer a birth from which on no slice has it */
    this.ends = [];
    this.paused = false;
  }

  /**
   * What to ask for now; null if nothing is worth it until something changes.
   * @param {import("./outlook.js").Outlook} outlook
   * @param {import("./sliceholding.js").SliceHolding} holding
   * @returns {import("./outlook.js").Send | null}
   */
  choose(outlook, holding) {
    const { media } = outlook;
    if (this.next === null) this.ends = new Array(media.numLayers).fill(holding.firstBirth);
    if (this.next === null || (outlook.paused && !this.paused)) {
      const oldest = Math.max(holding.firstBirth, outlook.nextFrame - media.swinSize + 1);
      this.next = new Array(media.numLayers).fill(oldest);
    }
    this.paused = outlook.paused;
    const rateBps = this.config.safety * outlook.rateBps;
    this.patienceS = this.patience.note(outlook);
    const freeS = outlook.comesS(0, rateBps);
    let best = 0;
    let chosen = null;
    for (let layer = 0; layer < media.numLayers; layer++) {
      const found = this.#first(outlook, holding, layer, freeS, rateBps, this.next);
      if (found !== null && found.priority > best) {
        best = found.priority;
        chosen = { layer, birth: found.birth };
      }
    }
    if (chosen === null) return null;
    const { layer, birth } = chosen;
    const most = outlook.runLength(media.sizes(birth).layerBytes[layer], rateBps);
    let end = birth + 1;
    while (end < outlook.endBirth && end - birth < most && holding.level(end) === layer) end += 1;
    this.next[layer] = end;
    this.ends[layer] = Math.max(this.ends[layer], end);
    if (layer + 1 < media.numLayers) this.next[layer + 1] = Math.min(this.next[layer + 1], birth);
    return { kind: "slices", birth, endBirth: end, firstLayer: layer, endLayer: layer + 1 };
  }

  /**
   * The first slice that lacks just `layer` and still shows it long enough.
   * @param {import("./outlook.js").Outlook} outlook
   * @param {import("./sliceholding.js").SliceHolding} holding
   * @param {number} layer
   * @param {number} freeS
   * @param {number} rateBps
   * @param {number[]} next
   */
  #first(outlook, holding, layer, freeS, rateBps, next) {
    const { config } = this;
    const { media, clock } = outlook;
    const { swinSize, fps } = media;
    const end = layer ? Math.min(outlook.endBirth, this.ends[layer - 1]) : outlook.endBirth;
    for (let birth = next[layer]; birth < end; birth++) {
      if (holding.level(birth) !== layer) continue;
      const sizes = media.sizes(birth);
      const size = Math.max(1, sizes.layerBytes[layer]);
      const slackS = outlook.dueS(birth) - freeS - (8 * size) / rateBps;
      let gainDb = layer ? sizes.gainsDb[layer] : config.stallDb;
      if (layer) {
        let life = Math.min(swinSize, birth + swinSize - clock.firstFrame);
        life -= Math.max(0, -slackS) * fps;
        if (outlook.paused) life = swinSize;
        if (life < config.leastLife * swinSize) continue;
        gainDb *= life / swinSize;
      }
      next[layer] = birth;
      const patienceS = this.patienceS[Math.min(layer, 1)];
      const priority = (gainDb / size) * Math.exp(-Math.max(0, slackS) / patienceS);
      return { priority, birth };
    }
    return null;
  }
}
