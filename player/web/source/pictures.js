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
  if (!Object.hasOwn(places, path)) return null;
  const { first, size } = places[path];
  const headers = { Range: `bytes=${first}-${first + size - 1}` };
  const response = await fetch(base, { headers, cache: "no-store" });
  if (response.status !== 206) return null;
  const bytes = await response.arrayBuffer();
  const ending = path.slice(path.lastIndexOf(".") + 1).toLowerCase();
  const type = `image/${ending === "jpg" ? "jpeg" : ending}`;
  const reader = new FileReader();
  return new Promise((resolve) => {
    reader.onload = () => resolve(/** @type {string} */ (reader.result));
    reader.onerror = () => resolve(null);
    reader.readAsDataURL(new Blob([bytes], { type }));
  });
}
