/** Where an object is, and the bytes of files and of parts of files. */

import { corrupt } from "../format/bytes.js";
import { fileUrl } from "./addresses.js";
import { SourceError } from "./fetcher.js";

/**
 * The URL of an object. Throws a FormatError if it is not a URL, and a SourceError if its origin is not
 * the manifest's and `otherHosts` is false.
 * @param {string} base @param {string} path as given by the manifest, possibly a whole URL
 * @param {boolean} otherHosts
 */
export function objectUrl(base, path, otherHosts) {
  const name = new URL("manifest.json", base).href;
  if (!URL.canParse(path, base))
    throw corrupt(`${name}: object_url gives ${path.slice(0, 200)}, which is not a URL`);
  const url = new URL(path, base);
  if (url.origin === new URL(base).origin) return fileUrl(path, base);
  if (!/^https?:$/.test(url.protocol))
    throw corrupt(`${name}: object_url gives ${url.href.slice(0, 200)}, which is not on the web`);
  if (!otherHosts) {
    throw new SourceError(
      `${name} leads to another host, ${url.origin.slice(0, 200)}; other-hosts, as an attribute of ` +
        "the player or other-hosts=1 in the address of its page, allows it",
    );
  }
  return url.href;
}

/**
 * A byte range of the file at a URL, shorter only at the file's end, and the size of the file, which is
 * null if the host hides it. Rejects like `Fetcher.get`, and if the host does not support ranges.
 * @param {import("./fetcher.js").Fetcher} fetcher @param {string} url
 * @param {import("./packed.js").Place} place @param {(numBytes: number) => void} [onBytes] see `get`
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

/**
 * The bytes of a file of the stream at `base`, from the manifest's folder or from the packed stream. Rejects with a
 * SourceError.
 * @param {import("./fetcher.js").Fetcher} fetcher @param {string} base @param {string} path
 * @param {import("./source.js").SourceStream["files"]} files @param {number} mostBytes @param {RequestInit} [init]
 */
export async function fileBytes(fetcher, base, path, files, mostBytes, init) {
  if (files === null) return fetcher.get(fileUrl(path, base), mostBytes, undefined, init);
  if (!Object.hasOwn(files, path)) throw new SourceError(`${base} holds no ${path}`);
  const { size } = files[path];
  if (!(size > 0 && size <= mostBytes))
    throw new SourceError(`${base}: ${path} has ${size} bytes, at most ${mostBytes}`);
  return (await fetchRange(fetcher, base, files[path], undefined, init)).bytes;
}

/**
 * The address of a part's object, relative to the manifest.
 * @param {{ objectUrl: string }} manifest @param {number} segment
 * @param {string} name of the part, or of a source of sound
 */
export function objectPath({ objectUrl }, segment, name) {
  return objectUrl.replace("{segment}", String(segment)).replace("{layer}", name);
}
