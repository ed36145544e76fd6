/** The element's public members, attributes, events and parts, as editors and documentation sites read them. */
import { readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";

import { create, ts } from "@custom-elements-manifest/analyzer";

const WEB = fileURLToPath(new URL("../", import.meta.url));

/** The element's class and those that it extends. */
const SOURCES = ["swingsplayer", "mediainterface", "pictureinterface"];

/** @typedef {{ name: string, kind?: string, description?: string, privacy?: string }} Described */

/**
 * A custom elements manifest, of version 1.0.0, of the element alone; see
 * https://github.com/webcomponents/custom-elements-manifest.
 */
export function elementsManifest() {
  const modules = SOURCES.map((name) => {
    const path = `element/${name}.js`;
    const text = readFileSync(`${WEB}${path}`, "utf8");
    return ts.createSourceFile(path, text, ts.ScriptTarget.ES2022, true);
  });
  const manifest = /** @type {any} */ (create({ modules }));
  const [{ declarations }] = manifest.modules;
  const found = declarations.find((/** @type {Described} */ { kind }) => kind === "class");
  // The constructor sets a property of the shadow root, not of the element.
  const members = found.members.filter(
    (/** @type {Described} */ { name, privacy }) =>
      (privacy ?? "public") === "public" && name !== "adoptedStyleSheets",
  );
  const path = "dist/element/swingsplayer.js";
  const declaration = { name: found.name, module: path };
  const exports = [
    { kind: "js", name: found.name, declaration },
    { kind: "custom-element-definition", name: "swings-player", declaration },
  ];
  // The analyser takes the parameter of `queueEvent` for another event.
  const events = found.events.filter((/** @type {Described} */ { name }) => name !== "type");
  const element = { ...found, members, events };
  delete element.superclass; // its members are among those of the element
  return {
    schemaVersion: manifest.schemaVersion,
    modules: [{ kind: "javascript-module", path, declarations: [element], exports }],
  };
}
