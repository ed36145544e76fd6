import { corrupt } from "../format/bytes/errors.js";
import { field, list, text } from "../format/bytes/json.js";

const MAX_CAPTIONS = 16;

/**
 * @typedef {object} CaptionTrack
 * @property {string} language
 * @property {string} label
 * @property {string} file beside the manifest
 */

/**
 * What a manifest says of captions. Throws a FormatError.
 * @param {unknown} value
 * @returns {CaptionTrack[]}
 */
export function readCaptionTracks(value) {
  return list(value, 0, MAX_CAPTIONS, "captions").map((one) => {
    const language = text(field(one, "language"), "language");
    if (!/^[A-Za-z0-9]{1,8}(?:-[A-Za-z0-9]{1,8}){0,3}$/.test(language))
      throw corrupt("manifest: captions have no such language");
    return {
      language,
      label: text(field(one, "label"), "label"),
      file: `captions-${language}.vtt`,
    };
  });
}
