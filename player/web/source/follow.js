import { followPeriodS } from "./liveedge.js";

/** A host may be wrong for so long, while its files are replaced, say. */
const PATIENCE_S = 60;

/**
 * Follows a live stream until it has ended. Rejects with what was wrong if that lasts.
 * @param {import("./hosted.js").HostedStream} stream
 * @param {() => void} onGrown called when it has more frames, or has ended
 */
export async function follow(stream, onGrown) {
  let goodMs = performance.now();
  while (stream.manifest.live) {
    await new Promise((resolve) => setTimeout(resolve, 1000 * followPeriodS(stream.manifest)));
    try {
      const isNew = await stream.refresh();
      goodMs = performance.now();
      if (isNew) onGrown();
    } catch (error) {
      if (performance.now() - goodMs > 1000 * PATIENCE_S) throw error;
    }
  }
}
