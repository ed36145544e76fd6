import { OVERLAY_STYLE } from "./overlaystyle.js";

/** Sizes grow with the player: 36 px for a button up to about 1800 px, 60 px at most. */
export const STYLE = /* css */ `
:host {
  display: block;
  position: relative;
  overflow: hidden;
  background: #000;
  color: #e8e8ea;
  aspect-ratio: 16 / 9;
  contain: content;
}
:host([hidden]) { display: none; }
:host(.covering) {
  position: fixed !important; inset: 0 !important; z-index: 2147483647 !important;
  width: 100% !important; height: 100dvh !important; max-width: none !important;
  max-height: none !important; aspect-ratio: auto !important; margin: 0 !important;
}
[hidden] { display: none !important; }
.frame {
  position: absolute; inset: 0; overflow: hidden;
  container-type: size;
  --accent: #8ab4ff;
  --panel: rgb(20 20 24 / 0.92);
  --played: #8ab4ff; --loaded: rgb(255 255 255 / 0.5); --rest: rgb(255 255 255 / 0.22);
  --least: 36px; --least-scrub: 24px;
  font: 13px/1.4 system-ui, sans-serif;
}
.controls { display: contents; }
.bar, .menu, .failure, .note.soft, .large, .spinner, .stats {
  --button: clamp(var(--least), 2cqw, 60px);
  --icon: calc(var(--button) * 0.56);
  font-size: clamp(13px, 0.72cqw, 20px);
}
canvas { position: absolute; inset: 0; width: 100%; height: 100%; }
canvas { touch-action: none; cursor: grab; outline: none; }
canvas:active { cursor: grabbing; }
.bar {
  position: absolute; left: 0; right: 0; bottom: 0;
  display: flex; flex-wrap: wrap; align-items: center; gap: 2px 6px;
  padding: 28px max(12px, env(safe-area-inset-right)) max(6px, env(safe-area-inset-bottom))
    max(12px, env(safe-area-inset-left));
  background: linear-gradient(transparent, rgb(0 0 0 / 0.75));
  transition: opacity 0.25s;
}
.idle .bar:not(:has(:focus-visible)) { opacity: 0; pointer-events: none; }
.idle canvas { cursor: none; }
[data-condition="loading"] .bar, [data-condition="failed"] :is(.bar, .menu, .stats) { display: none; }
[data-condition="failed"] canvas { pointer-events: none; }
.scrubber { position: relative; flex: 1 0 100%; height: max(var(--least-scrub), calc(var(--button) * 0.5)); }
.scrub {
  display: block; width: 100%; height: 100%; margin: 0;
  background: none; appearance: none; cursor: pointer; touch-action: none;
}
.scrub::-webkit-slider-runnable-track { height: max(4px, 0.2cqw); border-radius: 4px; background: var(--track); }
.scrub::-moz-range-track { height: max(4px, 0.2cqw); border-radius: 4px; background: var(--track); }
.scrub::-webkit-slider-thumb {
  appearance: none; width: 14px; height: 14px; margin-top: calc((max(4px, 0.2cqw) - 14px) / 2);
  border-radius: 50%; background: #fff;
}
.scrub::-moz-range-thumb { width: 14px; height: 14px; border: 0; border-radius: 50%; background: #fff; }
.preview {
  position: absolute; bottom: 100%; translate: -50% 0; pointer-events: none;
  border-radius: 6px; overflow: hidden; background: var(--panel); text-align: center;
}
.tile { width: clamp(120px, 14cqw, 320px); }
.hover-time { display: block; padding: 2px 8px; font-variant-numeric: tabular-nums; }
button, select, summary { border: 0; border-radius: 6px; color: inherit; font: inherit; cursor: pointer; }
button, select { background: none; }
.bar :is(button, select) { min-width: var(--button); height: var(--button); padding: 0 8px; }
.bar button { position: relative; }
:is(button, select, summary):hover { background: rgb(255 255 255 / 0.14); }
:is(button, select, input, summary):focus-visible { outline: 2px solid var(--accent); outline-offset: -2px; }
.tabbed canvas:focus-visible { outline: 2px solid var(--accent); outline-offset: -2px; }
button[aria-pressed="true"] { color: var(--accent); }
button[aria-pressed="true"]::after {
  content: ""; position: absolute; left: 25%; right: 25%; bottom: 3px; height: 3px;
  border-radius: 2px; background: currentColor;
}
select option { background: #1c1c20; }
svg { width: var(--icon); height: var(--icon); fill: currentColor; vertical-align: middle; }
.time { font-variant-numeric: tabular-nums; white-space: nowrap; }
.space { flex: 1; }
.bar .badge { display: none; padding: 0 4px; }
.bar .badge.on { display: inline-block; }
.badge span { padding: 2px 6px; border-radius: 4px; background: #c62828; color: #fff; font-size: 0.92em; font-weight: 600; }
.badge.behind span { background: #555; }
@media not (pointer: coarse) {
  @container (min-width: 640px) { .narrow { display: none !important; } }
  @container (max-width: 639.98px) { .wide { display: none !important; } }
}
@media (pointer: coarse) {
  @container (min-width: 720px) { .narrow { display: none !important; } }
  @container (max-width: 719.98px) { .wide { display: none !important; } }
  .frame { --least: 44px; --least-scrub: 44px; }
  .scrubber { margin-bottom: -8px; }
}
@media (forced-colors: active) {
  .frame { --accent: Highlight; --played: Highlight; --loaded: GrayText; --rest: Canvas; --panel: Canvas; }
  .bar { background: Canvas; padding-top: 6px; border-top: 1px solid CanvasText; }
  .scrub, .scrub::-webkit-slider-thumb { forced-color-adjust: none; }
  :is(button, select, .time, .note, .failure *) { color: CanvasText; background-color: Canvas; }
  .scrub::-webkit-slider-runnable-track { outline: 1px solid CanvasText; }
  .scrub::-moz-range-track { outline: 1px solid CanvasText; }
  .scrub::-webkit-slider-thumb { background: ButtonText; border: 1px solid Canvas; }
  .scrub::-moz-range-thumb { background: ButtonText; }
  .time, .hover-time { background: Canvas; color: CanvasText; }
  button[aria-pressed="true"]::after { background: Highlight; forced-color-adjust: none; }
  .badge span { border: 1px solid CanvasText; }
}
@media (prefers-reduced-motion: reduce) { .bar, .poster { transition: none; } }
${OVERLAY_STYLE}`;
