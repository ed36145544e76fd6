import { servedBase } from "../source/addresses.js";

/** @type {Set<string>} */
const preloaded = new Set();

/**
 * Begins to load what the play worker imports, and the code for the source of a stream: else they would be asked for
 * only when it runs. In the npm package, a worker is one file, and this does nothing.
 * @param {string} base URL of the stream
 */
export function preloadSource(base) {
  const source =
    servedBase(base) === null
      ? new URL("../source/hosted.js", import.meta.url)
      : new URL("../source/served.js", import.meta.url);
  for (const { href } of [new URL("./playcontroller.js", import.meta.url), source]) {
    if (preloaded.has(href)) continue;
    preloaded.add(href);
    const link = document.createElement("link");
    link.rel = "modulepreload";
    link.href = href;
    document.head.append(link);
  }
}
