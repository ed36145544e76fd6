/** Style of the bar and of the panel for failures. */
export const CONTROLS_STYLE = /* css */ `
.bar {
  position: absolute; left: 0; right: 0; bottom: 0;
  padding: 28px max(12px, env(safe-area-inset-right)) max(6px, env(safe-area-inset-bottom))
    max(12px, env(safe-area-inset-left));
  background: linear-gradient(transparent, rgb(0 0 0 / 0.75));
  transition: opacity 0.25s;
}
.row { display: flex; align-items: center; gap: 6px; white-space: nowrap; }
.row > * { flex: none; }
.row > .space { flex: 1; }
.row button { position: relative; min-width: var(--button); height: var(--button); padding: 0 8px; }
.row .dropped { display: none !important; }
.idle .bar:not(:has(:focus-visible)) { opacity: 0; pointer-events: none; }
[data-condition="failed"] :is(.bar, .menu, .stats),
:is([data-condition="loading"], [data-condition="empty"]) .bar { display: none; }
.still :is(.scrubber, .play, .time) { display: none; }
.scrubber { position: relative; height: max(var(--least-scrub), calc(var(--button) * 0.5)); }
.slider {
  --height: max(4px, 0.2cqw);
  display: block; width: 100%; height: 100%; margin: 0;
  background: none; appearance: none; cursor: pointer; touch-action: none;
}
.slider::-webkit-slider-runnable-track { height: var(--height); border-radius: 4px; background: var(--track); }
.slider::-moz-range-track { height: var(--height); border-radius: 4px; background: var(--track); }
.slider::-webkit-slider-thumb {
  appearance: none; width: 14px; height: 14px; margin-top: calc((var(--height) - 14px) / 2);
  border-radius: 50%; background: #fff;
}
.slider::-moz-range-thumb { width: 14px; height: 14px; border: 0; border-radius: 50%; background: #fff; }
.preview {
  position: absolute; bottom: 100%; translate: -50% 0; pointer-events: none;
  border-radius: 6px; overflow: hidden; background: var(--panel); text-align: center;
}
.tile { width: clamp(120px, 14cqw, 320px); }
.hover-time { display: block; padding: 2px 8px; font-variant-numeric: tabular-nums; }
button[aria-pressed="true"] { color: var(--accent); }
button[aria-pressed="true"]::after {
  content: ""; position: absolute; left: 25%; right: 25%; bottom: 3px; height: 3px;
  border-radius: 2px; background: currentColor;
}
.time { font-variant-numeric: tabular-nums; }
.row .badge { padding: 0 4px; }
.badge span { padding: 2px 6px; border-radius: 4px; background: #c62828; color: #fff; font-size: 0.92em; font-weight: 600; }
.badge.behind span { background: #555; }
@media (pointer: coarse) { .scrubber { margin-bottom: -8px; } .row { gap: 2px; } }
@container (max-height: 260px) { .bar { padding-block: 0 4px; } .scrubber { margin-bottom: 0; } }
.failure {
  position: absolute; left: 50%; top: 50%; translate: -50% -50%; box-sizing: border-box;
  width: min(88%, 34em); max-height: 92%; overflow: auto; padding: 1.4em;
  border-radius: 12px; background: #1c1c20; text-align: center;
}
.slides { position: absolute; inset: 0; display: grid; place-items: center; background: #000; }
.slides:has(.tile[hidden]) { background: none; }
.slides .tile { width: min(100cqw, 100cqh * var(--aspect)); }
.failure.final { inset: auto 0 12px; translate: none; width: fit-content; max-width: 88%; margin-inline: auto; padding: 0.8em 1.4em; }
.failure p { margin: 0 0 1em; overflow-wrap: anywhere; }
.failure:has(.retry[hidden]):has(details[hidden]) p { margin: 0; }
.failure .sentence { font-size: 1.25em; }
.failure .retry { min-height: max(36px, var(--least)); padding: 0 1.4em; background: #e8e8ea; color: #111; font-weight: 600; }
.failure .retry:hover { background: #fff; }
.failure details { margin-top: 1em; color: #c4c4cc; text-align: left; }
.failure summary { min-height: max(24px, var(--least)); line-height: max(24px, var(--least)); text-align: center; }
.failure .note { margin: 0.6em 0 0; font-size: 0.92em; }
@media (forced-colors: active) {
  .failure { border: 1px solid CanvasText; background: Canvas; }
  .bar { background: Canvas; padding-top: 6px; border-top: 1px solid CanvasText; }
  .slider, .slider::-webkit-slider-thumb { forced-color-adjust: none; }
  :is(.time, .hover-time, .failure *) { color: CanvasText; background-color: Canvas; }
  .slider::-webkit-slider-runnable-track { outline: 1px solid CanvasText; }
  .slider::-moz-range-track { outline: 1px solid CanvasText; }
  .slider::-webkit-slider-thumb { background: ButtonText; border: 1px solid Canvas; }
  .slider::-moz-range-thumb { background: ButtonText; }
  button[aria-pressed="true"]::after { background: Highlight; forced-color-adjust: none; }
  .badge span { border: 1px solid CanvasText; }
}
@media (prefers-reduced-motion: reduce) { .bar { transition: none; } }
`;
