import { PACKED_SUFFIX } from "../constants.js";

/** A path that names a stream of a swings server. */
const SERVED_PATH = /^(.*)\/(?:v1\/streams|watch)\/([^/]+)\/?$/;

/** Whether `url` is that of a packed stream. @param {string} url */
export function isPacked(url) {
  return servedBase(url) === null && new URL(url).pathname.endsWith(PACKED_SUFFIX);
}

/**
 * The URL of a stream's folder, with a slash at its end, or of a packed stream.
 * @param {string} src as the element has it
 * @param {string} page URL that it is relative to
 */
export function folderUrl(src, page) {
  const url = new URL(src, page).href;
  if (isPacked(url)) return url;
  return new URL(src.endsWith("/") ? src : `${src}/`, page).href;
}

/**
 * The URL of the stream on a swings server that `url` names, with a slash at its end; null where it
 * is not such an address.
 * @param {string} url
 */
export function servedBase(url) {
  const { origin, pathname } = new URL(url);
  const found = SERVED_PATH.exec(pathname);
  return found === null ? null : `${origin}${found[1]}/v1/streams/${found[2]}/`;
}

/**
 * The URL of a play on a swings server.
 * @param {string} base URL of the stream, with a slash at its end
 * @param {{ fromFrame: number, untilFrame?: number, layers?: number | null, paused?: boolean }} query
 *   layers: null for the server's choice
 */
export function playUrl(base, { fromFrame, untilFrame, layers, paused }) {
  const search = new URLSearchParams({ plain: "1", from: String(fromFrame) });
  if (untilFrame !== undefined) search.set("until", String(untilFrame));
  if (layers) search.set("layers", String(layers));
  if (paused) search.set("paused", "1");
  return `${base}play?${search}`;
}

/** The play with which a stream is opened: until it is known whether it plays, it does not. */
export const FIRST_PLAY = { fromFrame: 0, paused: true };

/**
 * The URLs that are fetched first, whatever the stream; of a packed one none is fetched whole.
 * @param {string} url see `folderUrl`
 */
export function firstUrls(url) {
  const served = servedBase(url);
  if (served !== null) return [playUrl(served, FIRST_PLAY)];
  if (isPacked(url)) return [];
  return [`${url}manifest.json`, `${url}index.bin`];
}
