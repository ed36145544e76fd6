/**
 * A picture in a packed stream, as a `data:` URL; null if there is none. See pictureUrl.
 * @param {string} base
 * @param {string} path
 * @param {Record<string, import("../format/packedlayout.js").Place>} places
 * @returns {Promise<string | null>}
 */
export async function packedPicture(base, path, places) {
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
