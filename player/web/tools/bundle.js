/**
 * Writes bundle/, which viewers get: the player in a few compact scripts, its page, and manifest.json, which says
 * what a page loads at first. Source maps lie beside, for tools alone. With --check it writes nothing, and fails where
 * bundle/ is not what the sources give.
 */
import { existsSync, mkdirSync, readdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { fileURLToPath } from "node:url";

import { minify as swc } from "@swc/core";
import { transform } from "esbuild";
import { rollup } from "rollup";
import { minify as terser } from "terser";

import * as constants from "../constants.js";
import { texts } from "./textmodules.js";

const WEB = fileURLToPath(new URL("../", import.meta.url));
const BUNDLE = `${WEB}bundle/`;

/**
 * The scripts by where they run: what a thread loads later shares the modules that it has already. Threads share
 * nothing, because a page would have to wait for more and smaller files.
 */
const THREADS = [
  { player: "element/swingsplayer.js" },
  { playworker: "playback/playworker.js" },
  { sortworker: "playback/sortworker.js" },
  { gaussianfeed: "feed/gaussianfeed.js" },
  { feedworker: "feed/feedworker.js" },
];

/** Sources of a page before anything else, by the kind of stream that it plays. */
const KINDS = { hosted: "hosted.js", served: "served.js" };
const FIRST = ["player.js", "playworker.js", "playcontroller.js", "sortworker.js"];

/**
 * The script with the modules of a worker that loads others later. It is not the worker's own script: WebKit runs that
 * once more when a module imports it.
 */
const INNER = { playworker: "playcontroller" };

/** How a source names a file beside it, such as a worker. */
const BESIDE = /new URL\("\.{1,2}\/(?:[\w.]+\/)*([\w.]+)", import\.meta\.url\)/g;

/** All files of the bundle lie in one folder. @type {import("rollup").Plugin} */
const flat = {
  name: "flat",
  transform: (code) => ({
    code: code.replace(BESIDE, 'new URL("./$1", import.meta.url)'),
    map: null,
  }),
};

const IMPORTED = /import \{([^}]*)\} from "[^"]*\/constants\.js";/;

/** Numbers and texts become part of each script, which then need not import and export them. @type {import("rollup").Plugin} */
const inlined = {
  name: "inlined-constants",
  transform(code) {
    const [statement, list] = IMPORTED.exec(code) ?? [];
    if (statement === undefined || list === undefined) return null;
    const values = /** @type {Record<string, unknown>} */ (constants);
    const names = list
      .split(",")
      .map((name) => name.trim())
      .filter(Boolean);
    const kept = names.filter((name) => typeof values[name] === "object");
    const consts = names
      .filter((name) => !kept.includes(name))
      .map((name) => `const ${name} = ${JSON.stringify(values[name])};`);
    const rest = kept.length > 0 ? statement.replace(list, kept.join(", ")) : "";
    // On as many lines as before, for the source maps.
    const lines = "\n".repeat(statement.split("\n").length - 1);
    return {
      code: code.replace(statement, () => rest.replaceAll("\n", " ") + consts.join(" ") + lines),
      map: null,
    };
  },
};

/** esbuild, terser and SWC one after another make 4 % less than any of them. @type {import("rollup").Plugin[]} */
const compact = [
  {
    name: "esbuild",
    async renderChunk(code) {
      const options = /** @type {const} */ ({
        minify: true,
        charset: "utf8",
        sourcemap: "external",
      });
      return transform(code, { ...options, target: "es2022", legalComments: "none" });
    },
  },
  {
    name: "terser",
    async renderChunk(code, _, { format }) {
      const { code: made = "", map } = await terser(code, {
        module: format === "es",
        ecma: 2020,
        mangle: false,
        compress: {
          passes: 3,
          keep_fargs: false,
          pure_getters: true,
          unsafe: true,
          unsafe_methods: true,
          hoist_funs: true,
        },
        sourceMap: { asObject: true },
      });
      return { code: made, map: /** @type {any} */ (map) };
    },
  },
  {
    name: "swc",
    renderChunk(code, _, { format }) {
      const module = format === "es";
      const mangle = { toplevel: module };
      const compress = { passes: 3, toplevel: module, inline: 0, sequences: false };
      return swc(code, { module, ecma: 2022, compress, mangle, sourceMap: true });
    },
  },
];

/** Scripts that have a module which other later scripts need as well; they come before those. */
const HOMES = { controls: "controls/controls.js", hosted: "source/hosted.js" };

/**
 * Few files: what both kinds of source need is part of the worker itself, and what several later scripts need has
 * one of HOMES.
 * @param {string} main path of the entry
 * @param {string} inner name of the script with the entry
 * @returns {import("rollup").GetManualChunk}
 */
function placing(main, inner) {
  return (id, { getModuleInfo }) => {
    const reach = (/** @type {string} */ from, seen = new Set()) => {
      if (seen.has(from)) return seen;
      seen.add(from);
      for (const one of getModuleInfo(from)?.importedIds ?? []) reach(one, seen);
      return seen;
    };
    const kinds = Object.values(KINDS).map((file) => reach(`${WEB}source/${file}`));
    if (reach(main).has(id) || kinds.every((kind) => kind.has(id))) return inner;
    return Object.entries(HOMES).find(([, path]) => reach(`${WEB}${path}`).has(id))?.[0];
  };
}

const plugins = [texts(), flat, inlined, ...compact];

/** @param {Record<string, string>} entry */
async function scripts(entry) {
  const [[name, path]] = Object.entries(entry);
  const main = `${WEB}${path}`;
  const input = { [name]: main };
  const inner = INNER[/** @type {keyof typeof INNER} */ (name)];
  const preserveEntrySignatures = inner ? "strict" : "allow-extension";
  const built = await rollup({ input, plugins, preserveEntrySignatures });
  const { output } = await built.generate({
    format: "es",
    entryFileNames: "[name].js",
    chunkFileNames: "[name].js",
    manualChunks: placing(main, inner ?? name),
    sourcemap: "hidden",
  });
  return output;
}

/** A script that a page contains, so that it sends the first requests at once. @param {string} path */
async function inlineScript(path) {
  const built = await rollup({ input: `${WEB}${path}`, plugins });
  const { output } = await built.generate({ format: "iife" });
  return output[0].code;
}

const SCRIPTS = /( *<script type="module" src="[^"]*"><\/script>\n)+/;

/** The page of the bundle: its own script inline, and preloads. @param {string[]} preloaded */
function page(preloaded) {
  const loads = preloaded.map((name) => `    <link rel="modulepreload" href="./${name}" />\n`);
  const tags = `    <script>${pageScript.trim()}</script>\n    <script type="module" src="./player.js"></script>\n`;
  return readFileSync(`${WEB}watch.html`, "utf8")
    .replace(SCRIPTS, () => tags)
    .replace("  </head>\n", () => `${loads.join("")}  </head>\n`);
}

/** @type {Map<string, import("rollup").OutputChunk>} */
const chunks = new Map();
for (const entry of THREADS) {
  for (const one of await scripts(entry)) {
    if (one.type !== "chunk") continue;
    // A small script that several threads load has to be the same in each.
    const { code = one.code } = chunks.get(one.fileName) ?? {};
    if (code !== one.code) throw new Error(`two threads make different scripts ${one.fileName}`);
    chunks.set(one.fileName, one);
  }
}
const pageScript = await inlineScript("watch.js");
const first = Object.fromEntries(
  Object.entries(KINDS).map(([kind, file]) => [
    kind,
    [...FIRST.slice(0, 3), file, ...FIRST.slice(3)],
  ]),
);
/** @type {Record<string, string>} each file, and its text */
const files = {
  ...Object.fromEntries([...chunks].map(([name, { code }]) => [name, code])),
  ...Object.fromEntries([...chunks].map(([name, { map }]) => [`${name}.map`, `${map}`])),
  "page.js": pageScript,
  "watch.html": page(first.hosted),
  "manifest.json": `${JSON.stringify({ first, harmonics: "colourpass.js" }, null, 2)}\n`,
};
for (const name of [...first.hosted, ...first.served]) {
  // A page asks for what is listed at once; what else it would wait for has to be listed, too.
  const { imports } = /** @type {import("rollup").OutputChunk} */ (chunks.get(name));
  const missing = imports.filter((one) => !FIRST.includes(one));
  if (missing.length > 0) throw new Error(`${name} imports ${missing}, which no page loads first`);
}
mkdirSync(BUNDLE, { recursive: true });
const others = readdirSync(BUNDLE).filter((name) => !(name in files));
if (process.argv.includes("--check")) {
  const read = (/** @type {string} */ name) =>
    existsSync(`${BUNDLE}${name}`) ? readFileSync(`${BUNDLE}${name}`, "utf8") : null;
  const stale = Object.keys(files).filter(
    (name) => !name.endsWith(".map") && read(name) !== files[name],
  );
  if (stale.length + others.length > 0) {
    console.error(`bundle/ is stale (${[...stale, ...others].join(", ")}): npm run build`);
    process.exitCode = 1;
  }
} else {
  for (const name of others) rmSync(`${BUNDLE}${name}`);
  for (const [name, text] of Object.entries(files)) writeFileSync(`${BUNDLE}${name}`, text);
}
