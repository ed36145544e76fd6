import { fileUrl } from "./addresses.js";

/** The pictures that a manifest names: the poster and the storyboard. */

/**
 * The URL of a picture of the stream at `base`; null if there is none.
 * @param {string} base
 * @param {string} path as in the manifest
 * @param {Record<string, import("../format/packedlayout.js").Place> | null} places of the files in
 *   a packed stream
 * @returns {Promise<string | null>}
 */
export async function pictureUrl(base, path, places) {
  if (places === null) {
    return fileUrl(path.split("/").map(encodeURIComponent).join("/"), base);
  }
  const { packedPicture } = await import("./packedpicture.js");
  return packedPicture(base, path, places);
}
