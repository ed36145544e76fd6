import { isBehind } from "../source/liveedge.js";

/**
 * Has the controls follow a stream that grows: the LIVE badge is on while it is live, and dim where what
 * shows is behind the edge; the scrub bar ends where the stream does.
 * @param {ShadowRoot} controls
 * @param {import("./webplayer.js").WebPlayer} player
 * @param {AbortSignal} signal
 */
export function followLive(controls, player, signal) {
  const badge = /** @type {HTMLElement} */ (controls.querySelector(".badge"));
  const scrub = /** @type {HTMLInputElement} */ (controls.querySelector(".scrub"));
  const show = () => {
    const { live, manifest, numFrames, state } = player;
    badge.classList.toggle("on", live);
    badge.classList.toggle("behind", live && isBehind(manifest, numFrames, state.frame));
    scrub.max = String(numFrames - 1);
  };
  for (const type of ["opened", "state", "grown"]) player.addEventListener(type, show, { signal });
}
