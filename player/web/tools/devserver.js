/**
 * Serves the repository for work on the player: `npm run dev`, or `node tools/devserver.js PORT`. Modules and
 * streams are read anew at each request; ranges are answered, as packed streams need them.
 */
import { readFile } from "node:fs/promises";
import { createServer } from "node:http";
import { fileURLToPath } from "node:url";

import sirv from "sirv";

import { isText, moduleOf } from "./textmodules.js";

const ROOT = fileURLToPath(new URL("../../../", import.meta.url));
const PORT = Number(process.argv[2] ?? 8080);
const SAMPLE = "?src=/conformance/streams/leases";
const PAGES = [
  [`/player/web/watch.html${SAMPLE}`, "the sample, played by the single modules"],
  [`/player/web/bundle/watch.html${SAMPLE}`, "the sample, played by the bundle"],
];

const files = sirv(ROOT, { dev: true, etag: true });

const server = createServer(async (request, response) => {
  const { pathname } = new URL(request.url ?? "/", "http://host");
  if (pathname === "/") {
    const links = PAGES.map(([url, name]) => `<li><a href="${url}">${name}</a></li>`);
    response.setHeader("Content-Type", "text/html");
    response.end(`<!doctype html><title>swings-player</title><ul>${links.join("")}</ul>`);
    return;
  }
  response.setHeader("Cache-Control", "no-cache");
  if (isText(pathname) && request.headers["sec-fetch-dest"] === "script") {
    response.setHeader("Content-Type", "text/javascript");
    const text = await readFile(`${ROOT}${decodeURIComponent(pathname)}`, "utf8").catch(() => null);
    if (text === null) response.statusCode = 404;
    response.end(text && moduleOf(text));
    return;
  }
  // Only tools read the maps: a comment with their address would be first load of all viewers.
  if (/\/bundle\/[^/]+\.js$/.test(pathname)) response.setHeader("SourceMap", `${pathname}.map`);
  files(request, response);
});
server.listen(PORT, "127.0.0.1", () => {
  console.info(`http://127.0.0.1:${PORT}/`);
});
