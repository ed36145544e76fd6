/** Modules that are texts, .glsl and .css: sources import them, and every tool that runs or builds the sources has this. */

const TEXT = /\.(glsl|css)$/;

/** @param {string} path @returns {boolean} whether it names a module that is a text */
export const isText = (path) => TEXT.test(path);

/** @param {string} text @returns {string} the module that gives it */
export const moduleOf = (text) => `export default ${JSON.stringify(text)};\n`;

/** @param {string} text of a style sheet */
const compactCss = (text) =>
  text
    .replace(/\/\*.*?\*\//gs, "")
    .replace(/\s+/g, " ")
    .replace(/ ?([{};,]) ?/g, "$1")
    .replaceAll(";}", "}")
    .replaceAll(": ", ":")
    .trim();

const OPERATOR = / ?([*/%=<>(){};,?:&|]|(?<![-+] ?)[-+](?! ?[-+])) ?/g;
/** Branches of the shared shaders, of which WebGL2 takes always the same: see `HEAD` in renderer/program.js. */
const BUFFERED = /#ifdef RESIDENT_BUFFER\n.*?#else\n(.*?)#endif\n/gs;
const STALE = /#ifdef STALE_ORDER\n(.*?)#endif\n/gs;

/** A line of the preprocessor stays one, and `a - -b` keeps its spaces. @param {string} text of a shader */
const compactGlsl = (text) =>
  text
    .replace(BUFFERED, "$1")
    .replace(STALE, "$1")
    .split("\n")
    .map((line) => line.replace(/\/\/.*/, "").trim())
    .filter((line) => line !== "")
    .map((line) => `${line.startsWith("#") ? line : line.replace(OPERATOR, "$1")}\n`)
    .join("");

/**
 * Texts without comments and spaces, as the code around them has none.
 * @returns {import("rollup").Plugin}
 */
export function texts() {
  return {
    name: "texts",
    transform(code, id) {
      if (!isText(id)) return null;
      const text = id.endsWith(".css") ? compactCss(code) : compactGlsl(code);
      return { code: moduleOf(text), map: { mappings: "" } };
    },
  };
}
