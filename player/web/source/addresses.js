/** URLs of streams, on a swings server, in a folder or packed, and the URLs made of them. */

import { PACKED_SUFFIX } from "../constants.js";

/** The path of a stream on a swings server. */
const SERVED_PATH = /^(.*)\/(?:v1\/streams|watch)\/([^/]+)\/?$/;

/** Whether `url` refers to a packed stream. @param {string} url */
export function isPacked(url) {
  return servedBase(url) === null && new URL(url).pathname.endsWith(PACKED_SUFFIX);
}

/**
 * The URL of a stream's folder, whose path ends with a slash, or of a packed stream; with its query, an
 * access token for example.
 * @param {string} src as in the element's attribute @param {string} page URL that `src` is relative to
 */
export function folderUrl(src, page) {
  const url = new URL(src, page);
  url.hash = "";
  if (!isPacked(url.href) && !url.pathname.endsWith("/")) url.pathname += "/";
  return url.href;
}

/**
 * The URL of a file of the stream at `base`, which gets the query of `base` unless it is on another host.
 * @param {string} path relative to the manifest @param {string} base
 */
export function fileUrl(path, base) {
  const url = new URL(path, base);
  const { origin, search } = new URL(base);
  if (url.origin === origin && url.search === "") url.search = search;
  return url.href;
}

/**
 * The URL of the stream on a swings server that `url` refers to, with a trailing slash; null if it is
 * not such an address.
 * @param {string} url
 */
export function servedBase(url) {
  const { origin, pathname } = new URL(url);
  const found = SERVED_PATH.exec(pathname);
  return found === null ? null : `${origin}${found[1]}/v1/streams/${found[2]}/`;
}

/**
 * The URL of a play on a swings server.
 * @param {string} base URL of the stream, with a trailing slash
 * @param {{ fromFrame: number, untilFrame?: number, layers?: number | null, paused?: boolean }} query
 *   layers: null for the server's choice
 */
export function playUrl(base, { fromFrame, untilFrame, layers, paused }) {
  const search = new URLSearchParams({ reports: "1", from: String(fromFrame) });
  if (untilFrame !== undefined) search.set("until", String(untilFrame));
  if (layers) search.set("layers", String(layers));
  if (paused) search.set("paused", "1");
  return `${base}play?${search}`;
}

/** The play that opens a stream: paused, because it is not yet known whether it will play. */
export const FIRST_PLAY = { fromFrame: 0, paused: true };

/**
 * The URLs that are fetched first for any stream; none for a packed stream, which is never fetched whole.
 * @param {string} url see `folderUrl`
 */
export function firstUrls(url) {
  const served = servedBase(url);
  if (served !== null) return [playUrl(served, FIRST_PLAY)];
  if (isPacked(url)) return [];
  return ["manifest.json", "index.bin"].map((name) => fileUrl(name, url));
}

/**
 * The URL of a picture that the manifest of an open stream names, the poster or the storyboard; null if there is none.
 * @param {import("../element/streamsession.js").StreamSession} session
 * @param {string} path as in the manifest @returns {Promise<string | null>}
 */
export async function pictureUrl({ base, files, source }, path) {
  const url = fileUrl(path.split("/").map(encodeURIComponent).join("/"), base);
  if (files === null && !source?.transformRequest) return url;
  const { fetchedPicture } = await import("./packedpicture.js");
  if (files === null) return fetchedPicture(url, path, source);
  return Object.hasOwn(files, path) ? fetchedPicture(base, path, source, files[path]) : null;
}
