import { MAX_CAPTIONS } from "../constants.js";
import { corrupt } from "../format/bytes/errors.js";
import { field, list, text } from "../format/bytes/json.js";

/**
 * @typedef {object} CaptionTrack
 * @property {string} language
 * @property {string} label
 * @property {string} file beside the manifest
 */

/**
 * The caption tracks in a manifest. Throws a FormatError.
 * @param {unknown} value
 * @returns {CaptionTrack[]}
 */
export function readCaptionTracks(value) {
  const tracks = list(value, 0, MAX_CAPTIONS, "captions").map((one) => {
    const language = text(field(one, "language"), "language");
    if (!/^[A-Za-z0-9]{1,8}(?:-[A-Za-z0-9]{1,8}){0,3}$/.test(language))
      throw corrupt("manifest: captions have no such language");
    const label = text(field(one, "label"), "label");
    if (!/^(?:[^\p{C}\p{Z}]| ){1,80}$/u.test(label))
      throw corrupt("manifest: a label of captions is not 1 to 80 printable characters");
    return { language, label, file: `captions-${language}.vtt` };
  });
  if (new Set(tracks.map(({ language }) => language.toLowerCase())).size !== tracks.length)
    throw corrupt("manifest: two captions have the same language");
  return tracks;
}
