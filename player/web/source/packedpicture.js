/**
 * A picture that an element cannot fetch itself, because it lies in a packed stream or the page changes requests, as
 * a `data:` URL; null if there is none. See pictureUrl.
 * @param {string} url @param {string} path @param {import("../playback/messages.js").Source | null} source
 * @param {import("./packed.js").Place} [place] in the packed stream @returns {Promise<string | null>}
 */
export async function fetchedPicture(url, path, source, place) {
  const { credentials, transformRequest } = source ?? {};
  /** @type {RequestInit} */
  const init = { credentials };
  if (place !== undefined) {
    init.headers = { Range: `bytes=${place.first}-${place.first + place.size - 1}` };
    init.cache = "no-store";
  }
  /** @type {[string, RequestInit]} */
  let request = [url, init];
  if (transformRequest) {
    const { transformed } = await import("./transform.js");
    request = await transformed(transformRequest, url, init);
  }
  const response = await fetch(...request);
  if (response.status !== (place === undefined ? 200 : 206)) return null;
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
