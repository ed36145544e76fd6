import { SourceError } from "./fetcher.js";

/**
 * A byte range of the file at a URL, shorter only at the file's end, and the size of the file, which is
 * null if the host hides it. Rejects like `Fetcher.get`, and if the host does not support ranges.
 * @param {import("./fetcher.js").Fetcher} fetcher
 * @param {string} url
 * @param {import("../format/packedlayout.js").Place} place
 * @param {(numBytes: number) => void} [onBytes] see `get`
 * @param {RequestInit} [init]
 */
export async function fetchRange(fetcher, url, { first, size }, onBytes, init = {}) {
  /** @type {number | null} */
  let fileBytes = null;
  const check = (/** @type {Response} */ response) => {
    if (response.status !== 206) {
      throw new SourceError(
        `${url}: this host does not send parts of a file, as a .swings file needs; use another host, ` +
          "or swings-stream unpack",
      );
    }
    // From another origin, the header is visible only if the host exposes it.
    const found = /^bytes (\d+)-\d+\/(\d+)$/.exec(response.headers.get("Content-Range") ?? "");
    if (found === null) return;
    fileBytes = Number(found[2]);
    if (Number(found[1]) !== first)
      throw new SourceError(`${url}: the host sent another part than requested`);
  };
  const headers = { Range: `bytes=${first}-${first + size - 1}` };
  // The browser's cache would serialise the requests for parts of the same file.
  const request = /** @type {RequestInit} */ ({ ...init, headers, cache: "no-store" });
  const bytes = await fetcher.get(url, size, onBytes, request, check);
  return { bytes, fileBytes: /** @type {number | null} */ (fileBytes) };
}
