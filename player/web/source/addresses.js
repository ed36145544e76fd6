import { PACKED_SUFFIX } from "../constants.js";

/** The path of a stream on a swings server. */
const SERVED_PATH = /^(.*)\/(?:v1\/streams|watch)\/([^/]+)\/?$/;

/** Whether `url` refers to a packed stream. @param {string} url */
export function isPacked(url) {
  return servedBase(url) === null && new URL(url).pathname.endsWith(PACKED_SUFFIX);
}

/**
 * The URL of a stream's folder, with a trailing slash, or of a packed stream.
 * @param {string} src as in the element's attribute
 * @param {string} page URL that `src` is relative to
 */
export function folderUrl(src, page) {
  const url = new URL(src, page).href;
  if (isPacked(url)) return url;
  return new URL(src.endsWith("/") ? src : `${src}/`, page).href;
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
  const search = new URLSearchParams({ plain: "1", reports: "1", from: String(fromFrame) });
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
  return [`${url}manifest.json`, `${url}index.bin`];
}
