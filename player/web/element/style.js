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
canvas { touch-action: pan-y; cursor: grab; outline: none; }
canvas:active { cursor: grabbing; }
.idle canvas { cursor: none; }
:is([data-condition="failed"], [data-condition="empty"]) canvas { pointer-events: none; }
[data-condition="empty"] canvas { visibility: hidden; }
button, summary { border: 0; border-radius: 6px; color: inherit; font: inherit; cursor: pointer; }
button { background: none; }
:is(button, summary):hover { background: rgb(255 255 255 / 0.14); }
:is(button, input, summary):focus-visible { outline: 2px solid var(--accent); outline-offset: -2px; }
.tabbed canvas:focus-visible { outline: 2px solid var(--accent); outline-offset: -2px; }
svg { width: var(--icon); height: var(--icon); fill: currentColor; vertical-align: middle; }
@media (pointer: coarse) { .frame { --least: 44px; --least-scrub: 44px; } }
@container (max-height: 260px) { .frame > * { --under: calc(var(--button) + 28px); --least-scrub: 24px; } }
@media (forced-colors: active) {
  .frame { --accent: Highlight; --played: Highlight; --loaded: GrayText; --rest: Canvas; --panel: Canvas; }
  :is(button, .note) { color: CanvasText; background-color: Canvas; }
}
@media (prefers-reduced-motion: reduce) { .poster { transition: none; } }
${OVERLAY_STYLE}`;
