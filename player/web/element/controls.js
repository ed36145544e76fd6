import { ICONS } from "./icons.js";

const RATES = [0.25, 0.5, 1, 1.5, 2];

/** A time as people write it. @param {number} seconds */
export function timeText(seconds) {
  const whole = Math.max(0, Math.floor(seconds));
  const minutes = Math.floor(whole / 60) % 60;
  const hours = Math.floor(whole / 3600);
  const pad = (/** @type {number} */ n) => String(n).padStart(2, "0");
  const rest = `${hours ? pad(minutes) : minutes}:${pad(whole % 60)}`;
  return hours ? `${hours}:${rest}` : rest;
}

// An emulator of headsets borrows the canvas, and gives it back to its parent if that is an element.
export const MARKUP = /* html */ `
<div><canvas tabindex="0" role="application"
  aria-label="Volumetric video. Drag to look around. Press space to play or pause."></canvas></div>
<img class="poster" alt="" hidden>
<div class="spinner" role="status" aria-label="Loading" hidden></div>
<pre class="stats" hidden></pre>
<div class="note" role="alert"></div>
<div class="note soft" role="status"></div>
<div class="bar" part="bar">
  <input class="scrub" type="range" min="0" max="0" step="1" value="0" aria-label="Seek">
  <button class="play" aria-label="Play">${ICONS.play}</button>
  <span class="time">0:00 / 0:00</span>
  <button class="badge" aria-label="Go to the live edge" title="Go to the live edge (End)"><span>LIVE</span></button>
  <span class="space"></span>
  <button class="reset wide" aria-label="Reset the view" title="Reset the view (R)">${ICONS.reset}</button>
  <button class="loop" aria-label="Loop" aria-pressed="false" title="Loop (L)">${ICONS.loop}</button>
  <select class="rate wide" aria-label="Speed">
    ${RATES.map((rate) => `<option value="${rate}"${rate === 1 ? " selected" : ""}>${rate}×</option>`).join("")}
  </select>
  <select class="quality" aria-label="Quality"><option value="0">Auto</option></select>
  <button class="share wide" aria-label="Copy a link to this moment and view" title="Copy a link (C)">${ICONS.share}</button>
  <button class="statistics wide" aria-label="Statistics" aria-pressed="false" title="Statistics (I)">${ICONS.stats}</button>
  <button class="side-by-side wide" aria-label="Side-by-side stereo view" aria-pressed="false" title="Side by side (B)">${ICONS.sideBySide}</button>
  <button class="headset" aria-label="Show on the VR headset" aria-pressed="false" title="VR (V)" hidden>${ICONS.headset}</button>
  <button class="full" aria-label="Full screen" title="Full screen (F)">${ICONS.full}</button>
</div>
`;
