/**
 * Writes dist/, which the npm package consists of: the modules of the player one by one, for bundlers, each
 * worker as one file, and the declarations of all of them. --untyped: without the declarations.
 */
import { execFileSync } from "node:child_process";
import { copyFileSync, readdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { basename } from "node:path";
import { fileURLToPath } from "node:url";

import { rollup } from "rollup";

import { elementsManifest } from "./elements.js";
import { texts } from "./textmodules.js";

const WEB = fileURLToPath(new URL("../", import.meta.url));
const DIST = `${WEB}dist/`;
const ENTRIES = [
  "core.js",
  "element/swingsplayer.js",
  "engines/spark.js",
  "feed/gaussianfeed.js",
  "watch.js",
];
const ENGINES = ["three", "@sparkjsdev/spark"];

/** The URL of a worker's module in a source: bundlers find it if it is written like this. */
const WORKER = /new URL\("(\.{1,2}\/[\w./]*worker\.js)", import\.meta\.url\)/g;

const TAG_TYPES = `
declare global {
  interface HTMLElementTagNameMap {
    "swings-player": SwingsPlayerElement;
  }
}
`;

/** Workers of the package are whole. */
const NO_PRELOAD = "export function preloadSource() {}\n";

/** @type {Set<string>} paths of the modules that start as workers */
const workers = new Set();

/** Makes modules start the workers of workers/. @type {import("rollup").Plugin} */
const packedWorkers = {
  name: "packed-workers",
  transform(code, id) {
    if (id === `${WEB}playback/preload.js`) return { code: NO_PRELOAD, map: { mappings: "" } };
    const up = "../".repeat(id.slice(WEB.length).split("/").length - 1) || "./";
    const packed = code.replace(WORKER, (_, path) => {
      workers.add(fileURLToPath(new URL(path, `file://${id}`)));
      return `new URL("${up}workers/${basename(path)}", import.meta.url)`;
    });
    return { code: packed, map: null };
  },
};

/**
 * @param {import("rollup").RollupOptions & { input: string | string[] }} from
 * @param {import("rollup").OutputOptions} to
 */
async function write(from, to) {
  const built = await rollup({ external: ENGINES, treeshake: false, ...from });
  await built.write({ format: "es", sourcemap: true, ...to });
}

async function writeModules() {
  const input = ENTRIES.map((name) => `${WEB}${name}`);
  const each = { dir: DIST, preserveModules: true, preserveModulesRoot: WEB };
  await write({ input, plugins: [texts(), packedWorkers] }, each);
  // Bundlers copy a worker without following its imports.
  for (const input of [...workers].sort()) {
    const file = `${DIST}workers/${basename(input)}`;
    await write(
      { input, plugins: [texts()], treeshake: true },
      { file, inlineDynamicImports: true },
    );
  }
}

function writeTypes() {
  const emits = ["--noEmit", "false", "--declaration", "--emitDeclarationOnly"];
  const places = ["--rootDir", WEB, "--outDir", DIST];
  execFileSync(
    `${WEB}node_modules/.bin/tsc`,
    ["-p", `${WEB}tsconfig.dist.json`, ...emits, ...places],
    {
      stdio: "inherit",
    },
  );
  for (const name of readdirSync(DIST, { recursive: true }).map(String)) {
    if (!name.endsWith(".d.ts")) continue;
    const text = readFileSync(`${DIST}${name}`, "utf8");
    // TypeScript has no types of WebXR, and the package depends on no other.
    const unknown = [...new Set(text.match(/\bXR[A-Z]\w+/g))].sort();
    const types = unknown.map((type) => `type ${type} = any;\n`).join("");
    const tag = name === "element/swingsplayer.d.ts" ? TAG_TYPES : "";
    writeFileSync(`${DIST}${name}`, text + types + tag);
  }
}

rmSync(DIST, { recursive: true, force: true });
await writeModules();
if (!process.argv.includes("--untyped")) writeTypes();
writeFileSync(`${DIST}custom-elements.json`, `${JSON.stringify(elementsManifest(), null, 2)}\n`);
copyFileSync(`${WEB}watch.html`, `${DIST}watch.html`);
copyFileSync(`${WEB}../../LICENSE`, `${WEB}LICENSE`);
