/** Texts for viewers: each table has all of them, and nothing else. */
import assert from "node:assert/strict";
import { readdirSync, readFileSync } from "node:fs";
import { test } from "node:test";
import { translatorOf } from "../controls/texts.js";
import { GONE, REPLACED, SILENT } from "../source/fetcher.js";
import { BUSY } from "../source/playresponse.js";

const WEB = new URL("../", import.meta.url);
const TEXT = '"((?:[^"\\\\]|\\\\.)+)"';

/** How the code names a text that viewers read. */
const SHOWN = [
  /\b(?:t|say|hint|fail|onTrouble|HeadsetError|RendererError)\(\s*TEXT/,
  /\b(?:aria-label"|label):\s+TEXT/,
  /\bdispatch\("trouble", TEXT/,
  /#copy\(\w+, TEXT/,
].map(({ source }) => new RegExp(source.replace("TEXT", TEXT), "g"));

/** Where all texts of a kind are viewers'. */
const IN_FILE = {
  "controls/keys.js": new RegExp(`\\], ${TEXT}\\]`, "g"),
  "controls/panels.js": /"([A-Z][^"]+\.)"/g,
};

function textsOfCode() {
  const found = new Set([REPLACED, ...[GONE, SILENT, BUSY].map((why) => `${why}; trying again`)]);
  const isCode = (path) =>
    /^(controls|element|playback|renderer|sound|source|stereo|view)\/[^.]*\.js$/.test(path);
  for (const path of readdirSync(WEB, { recursive: true }).filter(isCode)) {
    const code = readFileSync(new URL(path, WEB), "utf8").replace(/" \+\s+"/g, "");
    for (const pattern of [...SHOWN, ...(IN_FILE[path] ? [IN_FILE[path]] : [])])
      for (const [, text] of code.matchAll(pattern)) found.add(text);
  }
  return [...found].sort();
}

const placesIn = (text) => [...text.matchAll(/\{\w+\}/g)].map(([place]) => place).sort();
const LANGUAGES = readdirSync(new URL("controls/texts/", WEB)).map((name) => name.split(".")[0]);

for (const language of LANGUAGES) {
  test(`the table ${language} has all texts, none that is unused, and none in English`, async () => {
    const { default: table } = await import(`../controls/texts/${language}.js`);
    assert.deepEqual(Object.keys(table).sort(), textsOfCode());
    for (const [text, translated] of Object.entries(table)) {
      assert.ok(translated.trim() !== "", text);
      assert.deepEqual(placesIn(translated), placesIn(text), text);
    }
    const same = Object.entries(table).filter(([text, translated]) => text === translated);
    assert.ok(same.length < 8, `${same} of ${language}`);
  });
}

test("viewers read the language of the element, or of the page, or of the browser", async (context) => {
  const { mock } = context.mock.method(console, "warn", () => {});
  const at = (lang) => ({ closest: () => (lang === null ? null : { lang }) });
  const playIn = async (lang) => (await translatorOf(at(lang))).t("Play");
  const browser = (language) =>
    Object.defineProperty(globalThis, "navigator", { value: { language }, configurable: true });
  const { navigator } = globalThis;
  context.after(() => Object.defineProperty(globalThis, "navigator", { value: navigator }));
  browser("fr-CA");
  for (const [lang, play] of [
    ["de", "Abspielen"],
    ["de-AT", "Abspielen"],
    ["en-GB", "Play"],
    ["ja", "Play"],
    ["constructor", "Play"],
    ["", "Lire"],
    [null, "Lire"],
  ])
    assert.equal(await playIn(lang), play, lang);
  assert.equal((await translatorOf(at("ja"))).language, "en");
  const { t, language } = await translatorOf(at("DE"));
  assert.equal(language, "de");
  assert.equal(t("{count} layers", { count: "3" }), "3 Ebenen");
  assert.equal(t("unknown {x}", { x: "$&" }), "unknown $&");
  assert.equal(mock.callCount(), 0);
});
