/** `node --import tools/nodehooks.js`: Node runs sources that import texts. */
import { readFile } from "node:fs/promises";
import { register } from "node:module";
import { fileURLToPath } from "node:url";
import { isMainThread } from "node:worker_threads";

import { isText, moduleOf } from "./textmodules.js";

if (isMainThread) register(import.meta.url);

/** @type {import("node:module").LoadHook} */
export async function load(url, context, next) {
  if (!isText(url)) return next(url, context);
  const source = moduleOf(await readFile(fileURLToPath(url), "utf8"));
  return { format: "module", shortCircuit: true, source };
}
