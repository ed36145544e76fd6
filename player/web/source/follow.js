import { followPeriodS } from "./liveedge.js";

/** Errors of a host are tolerated for this time, for example while its files are replaced. */
const TOLERATED_S = 60;
/** Seconds between two checks while the stream is paused: its edge stays known closely enough to count as live. */
const PAUSED_PERIOD_S = 2.5;

/**
 * Follows a live stream until it has ended. Rejects with the host's error if that lasts.
 * @param {import("./hosted.js").HostedStream} stream
 * @param {() => void} onGrown called when the stream has more frames, or has ended
 */
export async function follow(stream, onGrown) {
  let goodMs = performance.now();
  while (stream.manifest.live) {
    const periodS = followPeriodS(stream.manifest);
    let waitedS = 0;
    do {
      await new Promise((resolve) => setTimeout(resolve, 1000 * periodS));
      waitedS += periodS;
    } while (stream.isPaused && waitedS < PAUSED_PERIOD_S);
    try {
      const isNew = await stream.refresh();
      goodMs = performance.now();
      if (isNew) onGrown();
    } catch (error) {
      console.warn(`The stream could not be looked for: ${error}`);
      if (performance.now() - goodMs > 1000 * TOLERATED_S) throw error;
    }
  }
}
