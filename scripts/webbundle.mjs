/**
 * Bundles a source of player/web: `node webbundle.mjs MODULES SOURCE FORMAT` writes the script to stdout.
 * MODULES has esbuild, which bundles, and terser, which makes 3 % less of what esbuild minifies.
 * CSS and GLSL in templates lose their comments and spaces, as the code around them does.
 */
import { readFile } from "node:fs/promises";
import { basename } from "node:path";

const [modules, source, format] = process.argv.slice(2);
const { build } = await import(`${modules}/esbuild/lib/main.js`);
const { minify } = await import(`${modules}/terser/main.js`);

/** @param {string} text */
const css = (text) =>
  text
    .replace(/\/\*.*?\*\//gs, "")
    .replace(/\s+/g, " ")
    .replace(/ ?([{};,]) ?/g, "$1");

const OPERATOR = / ?([*/%=<>(){};,?:&|]|(?<![-+] ?)[-+](?! ?[-+])) ?/g;
/**
 * A line of the preprocessor stays one, also the last one, since another text may follow it; and `a - -b`
 * keeps its spaces. @param {string} text
 */
const glsl = (text) =>
  text
    .split("\n")
    .map((line) => line.replace(/\/\/.*/, "").trim())
    .filter((line) => line !== "")
    .map((line) => `${line.startsWith("#") ? line : line.replace(OPERATOR, "$1")}\n`)
    .join("");

const compact = {
  name: "compact-templates",
  setup(/** @type {any} */ { onLoad }) {
    onLoad({ filter: /\.js$/ }, async ({ path }) => {
      const code = await readFile(path, "utf8");
      const contents = code
        .replace(/(\/\* css \*\/ `)([^`]*)`/g, (_, begin, text) => `${begin}${css(text)}\``)
        .replace(/(\/\* glsl \*\/ `)([^`]*)`/g, (_, begin, text) => `${begin}${glsl(text)}\``);
      return { contents, loader: "js" };
    });
  },
};

/** What is loaded later is a bundle of its own, beside the one that loads it. */
const later = {
  name: "later",
  setup(/** @type {any} */ { onResolve }) {
    onResolve({ filter: /\.js$/ }, (/** @type {any} */ { path, kind }) =>
      kind === "dynamic-import" ? { path: `./${basename(path)}`, external: true } : undefined,
    );
  },
};

const { outputFiles } = await build({
  entryPoints: [source],
  bundle: true,
  minify: true,
  write: false,
  format,
  target: "es2022",
  charset: "utf8",
  legalComments: "none",
  logLevel: "warning",
  define: { SWINGS_BUNDLE: "true" },
  plugins: [compact, later],
});
const { code } = await minify(outputFiles[0].text, {
  module: format === "esm",
  ecma: 2020,
  compress: { passes: 3, keep_fargs: false },
});
process.stdout.write(code);
