import { servedBase } from "../source/addresses.js";

/** @type {Set<string>} */
const preloaded = new Set();

/**
 * Begins to load the code for the source of a stream, which the play worker imports: else it would ask for it only
 * when it runs. In the npm package, a worker is one file, and this does nothing.
 * @param {string} base URL of the stream
 */
export function preloadSource(base) {
  const { href } =
    servedBase(base) === null
      ? new URL("../source/hosted.js", import.meta.url)
      : new URL("../source/served.js", import.meta.url);
  if (preloaded.has(href)) return;
  preloaded.add(href);
  const link = document.createElement("link");
  link.rel = "modulepreload";
  link.href = href;
  document.head.append(link);
}
