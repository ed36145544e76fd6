/**
 * What a client holds where slots last (server/abr/slotholding.py): of each layer chains, each from
 * the frame of a snapshot to the last change that follows without a gap.
 */
export class SlotHolding {
  /**
   * @param {import("./media.js").Media} media
   * @param {number} firstFrame
   */
  constructor(media, firstFrame) {
    this.media = media;
    this.firstFrame = firstFrame;
    /** @type {[number, number][][]} of each layer the chains [first frame, last birth], in order */
    this.chains = Array.from({ length: media.numLayers }, () => []);
    /** The first frame that cannot show. */
    this.endFrame = firstFrame;
  }

  /** The birth after the last one of this layer's last chain; null without one. @param {number} layer */
  endBirth(layer) {
    const chains = this.chains[layer];
    return chains.length > 0 ? chains[chains.length - 1][1] + 1 : null;
  }

  /**
   * Adds the packets of layers firstLayer .. endLayer - 1 of a slice.
   * @param {number} birth
   * @param {number} firstLayer
   * @param {number} endLayer
   */
  add(birth, firstLayer, endLayer) {
    for (let layer = firstLayer; layer < endLayer; layer++) {
      for (const chain of this.chains[layer]) if (chain[1] === birth - 1) chain[1] = birth;
      this.#join(layer);
    }
    this.#reach();
  }

  /**
   * Adds the snapshots of these layers at `frame`.
   * @param {number} frame
   * @param {number} firstLayer
   * @param {number} endLayer
   */
  addSnapshots(frame, firstLayer, endLayer) {
    for (let layer = firstLayer; layer < endLayer; layer++) {
      const chains = this.chains[layer];
      if (!chains.some(([first, last]) => first <= frame && frame <= last)) {
        chains.push([frame, frame]);
        chains.sort(([a, b], [c, d]) => a - c || b - d);
      }
    }
    this.#reach();
  }

  /** Frames before `frame` are not asked for any more. @param {number} frame */
  forget(frame) {
    for (const chains of this.chains) {
      while (chains.length > 1 && chains[1][0] <= frame) chains.shift();
    }
  }

  /**
   * Whether all layers are here of all that changes in frame .. endFrame - 1.
   * @param {number} frame
   * @param {number} endFrame
   */
  isComplete(frame, endFrame) {
    return this.chains.every((chains) =>
      chains.some(([first, last]) => first <= frame && last >= endFrame - 1),
    );
  }

  /** Notes how far layer 0 goes without a gap: a later snapshot does not fill one. */
  #reach() {
    for (const [first, last] of this.chains[0]) {
      if (first <= this.endFrame) this.endFrame = Math.max(this.endFrame, last + 1);
    }
  }

  /** Makes one of two chains of which the first has grown into the second. @param {number} layer */
  #join(layer) {
    const chains = this.chains[layer];
    for (let n = chains.length - 1; n > 0; n--) {
      if (chains[n - 1][1] >= chains[n][0]) {
        chains[n - 1][1] = Math.max(chains[n - 1][1], chains[n][1]);
        chains.splice(n, 1);
      }
    }
  }
}
