/**
 * The script of a page with one player: applies the address's query to the element, and sends the first
 * requests while the element's own code is still being loaded.
 *
 * Query: t (seconds), view, lang, loop, autoplay, interpolate, max-gaussians, other-hosts, buffer-mb; and src (the
 * stream's folder) if the page itself does not set it.
 */

import { firstUrls, folderUrl } from "./source/addresses.js";
import { requestEarly } from "./source/early.js";

const query = new URLSearchParams(location.search);
const player = /** @type {HTMLElement} */ (document.querySelector("swings-player"));
const src = player.getAttribute("src") ?? query.get("src") ?? "./";
const isFramed = window.parent !== window;
// A frame may be out of view, where nothing should be fetched yet.
if (!isFramed && !document.hidden) {
  for (const url of firstUrls(folderUrl(src, document.baseURI))) requestEarly(url);
}
player.setAttribute("src", src);
player.setAttribute("link", location.href);
player.lang = query.get("lang") ?? navigator.language;
for (const [name, attribute] of [
  ["t", "start"],
  ["view", "view"],
  ["max-gaussians", "max-gaussians"],
  ["buffer-mb", "buffer-mb"],
  ["interpolate", "interpolate"],
]) {
  const value = query.get(name);
  if (value !== null) player.setAttribute(attribute, value);
}
player.toggleAttribute("other-hosts", query.get("other-hosts") === "1");
player.toggleAttribute("loop", query.get("loop") !== "0");
player.toggleAttribute("autoplay", query.get("autoplay") !== "0");
// The page is about the player; in a frame, one finger and the wheel scroll the page around it.
if (!isFramed) player.setAttribute("gestures", "all");
// A page that shows this one in a frame needs only the player.
document.documentElement.classList.toggle("framed", isFramed);
document.addEventListener("click", async ({ target }) => {
  const button = target instanceof HTMLElement ? target : null;
  const source = document.getElementById(button?.dataset.copy ?? "");
  if (button === null || source === null) return;
  try {
    await navigator.clipboard.writeText(source.textContent ?? "");
    button.textContent = "Copied";
  } catch (error) {
    console.info("swings: this page has no clipboard, as pages without TLS:", error);
    getSelection()?.selectAllChildren(source);
  }
});
// Forwards keys, so that they work without a click. Focusing the player at once would draw a focus ring.
document.addEventListener("keydown", (event) => {
  if (event.target !== document.body || event.key === "Tab") return;
  player.focus();
  player.dispatchEvent(new KeyboardEvent("keydown", event));
});
