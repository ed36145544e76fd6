import { corrupt } from "../format/bytes.js";
import { keyframeOf, limitBytes } from "../format/manifest.js";
import { readObject } from "../format/objects.js";

/** Most bytes of an object, for those of its chunk: a table, and blocks that do not shrink. @param {number} size */
const objectBytes = (size) => Math.ceil(1.01 * size) + 1024;

/**
 * Fetches the keyframe of a layer from a swings server into the cache: a play from a segment's start sends it itself.
 * @param {import("./served.js").ServedStream} stream @param {number} segment @param {number} layer
 * @param {AbortSignal} signal
 */
export async function fetchKeyframe({ base, cache, fetcher, manifest }, segment, layer, signal) {
  const part = keyframeOf(manifest, layer);
  const most = objectBytes(limitBytes(manifest, part));
  const url = `${base}segments/${segment}/${manifest.parts[part]}`;
  const bytes = await fetcher.get(url, most, undefined, { signal });
  const frame = segment * manifest.segmentFrames;
  const packet = readObject(bytes).get(frame);
  if (packet === undefined) throw corrupt(`${url} has no keyframe of frame ${frame}`);
  cache.add(frame, part, packet);
}
