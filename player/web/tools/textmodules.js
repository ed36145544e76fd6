/** Modules that are texts, .glsl and .css: sources import them, and every tool that runs or builds the sources has this. */

import { transform } from "esbuild";

const TEXT = /\.(glsl|css)$/;

/** @param {string} path @returns {boolean} whether it names a module that is a text */
export const isText = (path) => TEXT.test(path);

/** @param {string} text @returns {string} the module that gives it */
export const moduleOf = (text) => `export default ${JSON.stringify(text)};\n`;

/** @param {string} text of a style sheet */
const compactCss = async (text) =>
  (await transform(text, { loader: "css", minify: true, target: "es2022" })).code
    .replace(/([:,]) /g, "$1")
    .trim();

const OPERATOR = / ?([*/%=<>(){};,?:&|]|(?<![-+] ?)[-+](?! ?[-+])) ?/g;
/** Branches of the shared shaders, of which WebGL2 takes always the same: see `HEAD` in renderer/program.js. */
const BUFFERED = /#ifdef RESIDENT_BUFFER\n.*?#else\n(.*?)#endif\n/gs;
const STALE = /#ifdef STALE_ORDER\n(.*?)#endif\n/gs;

/** A type, and the variable or parameter that it declares. */
const DECLARED = /\b(?:float|u?int|[iu]?vec[234]|mat3) (\w+)\b(?!\()/g;
/** What the stages of a shader hand on. */
const HANDED_ON = /\b(?:out|flat in) \w+ (\w+)/g;
/** Macros are upper case. */
const LETTERS = [..."abcdefghijklmnopqrstuvwxyz"];
const SHORT = [...LETTERS, ...LETTERS.map((letter) => `${letter}_`)];

/**
 * Parameters, local variables, and what its stages hand on, get the shortest names that a shader does not have. What
 * else stands outside of functions keeps its name: other texts and the program know it.
 * @param {string} text compact
 */
function shortened(text) {
  const globals = new Set();
  let depth = 0;
  for (const [token] of text.matchAll(/\w+|[(){}]/g)) {
    if (/[({]/.test(token)) depth += 1;
    else if (/[)}]/.test(token)) depth -= 1;
    else if (depth === 0) globals.add(token);
  }
  const words = text.match(/\w+/g) ?? [];
  const free = SHORT.filter((name) => !words.includes(name));
  /** @type {Map<string, string>} */
  const shorter = new Map();
  const handedOn = Array.from(text.matchAll(HANDED_ON), ([, name]) => name);
  const locals = Array.from(text.matchAll(DECLARED), ([, name]) => name).filter(
    (name) => name.length > 2 && !globals.has(name),
  );
  for (const name of new Set([...handedOn, ...locals])) shorter.set(name, free.shift() ?? name);
  return text.replace(/(?<![.\w])[a-z]\w*/g, (name) => shorter.get(name) ?? name);
}

/** A line of the preprocessor stays one, and `a - -b` keeps its spaces. @param {string} text of a shader */
const compactGlsl = (text) =>
  shortened(
    text
      .replace(BUFFERED, "$1")
      .replace(STALE, "$1")
      .replace(/\/\/.*/g, "")
      .split(/^\s*(#.*\n)/m)
      .map((part) =>
        part.startsWith("#")
          ? `${part.trim()}\n`
          : part
              .trim()
              .replace(/\s+/g, " ")
              .replace(OPERATOR, "$1")
              .replace(/\b0(\.\d)|(\d\.)0\b/g, "$1$2")
              .replace(/.$/, "$&\n"),
      )
      .join(""),
  );

/**
 * Texts without comments and spaces, as the code around them has none.
 * @returns {import("rollup").Plugin}
 */
export function texts() {
  return {
    name: "texts",
    async transform(code, id) {
      if (!isText(id)) return null;
      const text = id.endsWith(".css") ? await compactCss(code) : compactGlsl(code);
      return { code: moduleOf(text), map: { mappings: "" } };
    },
  };
}
