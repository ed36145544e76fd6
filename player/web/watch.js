/**
 * The page of one stream: `watch.html?src=FOLDER`, or `/watch/NAME` of a swings server; perhaps with t
 * (seconds), view, loop, autoplay, max-gaussians.
 */

import "./element/swingsplayer.js";

const query = new URLSearchParams(location.search);
const player = document.createElement("swings-player");
const isServed = /\/watch\/[^/]+$/.test(location.pathname);
const own = isServed ? location.origin + location.pathname : "./";
player.setAttribute("src", query.get("src") ?? own);
player.setAttribute("link", location.href);
for (const [name, attribute] of [
  ["t", "start"],
  ["view", "view"],
  ["max-gaussians", "max-gaussians"],
]) {
  const value = query.get(name);
  if (value !== null) player.setAttribute(attribute, value);
}
player.toggleAttribute("loop", query.get("loop") !== "0");
player.toggleAttribute("autoplay", query.get("autoplay") !== "0");
document.body.append(player);
// Keys work before anything was clicked; a focus from the start would put a frame around the picture.
document.addEventListener("keydown", (event) => {
  if (event.target !== document.body) return;
  player.focus();
  player.dispatchEvent(new KeyboardEvent("keydown", event));
});
