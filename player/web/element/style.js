export const STYLE = /* css */ `
:host {
  display: block;
  position: relative;
  overflow: hidden;
  background: #000;
  color: #e8e8ea;
  font: 13px/1.4 system-ui, sans-serif;
  aspect-ratio: 16 / 9;
  contain: content;
}
:host([hidden]) { display: none; }
canvas, .poster { position: absolute; inset: 0; width: 100%; height: 100%; }
canvas { touch-action: none; cursor: grab; outline: none; }
canvas:active { cursor: grabbing; }
.poster { object-fit: contain; pointer-events: none; transition: opacity 0.3s; }
.poster.gone { opacity: 0; }
.bar {
  position: absolute; left: 0; right: 0; bottom: 0;
  display: flex; flex-wrap: wrap; align-items: center; gap: 2px 6px;
  padding: 28px 12px 8px;
  background: linear-gradient(transparent, rgb(0 0 0 / 0.75));
  transition: opacity 0.25s;
}
:host(.idle) .bar { opacity: 0; }
:host(.idle) canvas { cursor: none; }
.bar:focus-within { opacity: 1 !important; }
.scrub { flex: 1 0 100%; height: 16px; margin: 0; accent-color: #8ab4ff; background: none; appearance: none; cursor: pointer; }
.scrub::-webkit-slider-runnable-track { height: 4px; border-radius: 2px; background: var(--track); }
.scrub::-moz-range-track { height: 4px; border-radius: 2px; background: var(--track); }
.scrub::-webkit-slider-thumb { appearance: none; width: 14px; height: 14px; margin-top: -5px; border-radius: 50%; background: #fff; }
.scrub::-moz-range-thumb { width: 14px; height: 14px; border: 0; border-radius: 50%; background: #fff; }
button, select {
  min-width: 36px; height: 36px; padding: 0 8px;
  border: 0; border-radius: 6px; background: none; color: inherit; font: inherit; cursor: pointer;
}
button:hover, select:hover { background: rgb(255 255 255 / 0.14); }
:is(button, select, input, canvas):focus-visible { outline: 2px solid #8ab4ff; outline-offset: -2px; }
button[aria-pressed="true"] { color: #8ab4ff; }
select option { background: #1c1c20; }
svg { width: 20px; height: 20px; fill: currentColor; vertical-align: middle; }
.time { font-variant-numeric: tabular-nums; }
.space { flex: 1; }
.badge { display: none; padding: 0 4px; }
.badge.on { display: inline-block; }
.badge span { padding: 2px 6px; border-radius: 4px; background: #d33; color: #fff; font-size: 12px; font-weight: 600; }
.badge.behind span { background: #555; }
.note {
  position: absolute; left: 50%; top: 50%; translate: -50% -50%;
  max-width: min(80%, 420px); padding: 10px 16px; border-radius: 8px;
  background: rgb(20 20 24 / 0.85); text-align: center;
}
.note:empty { display: none; }
.note.soft { top: 12px; translate: -50% 0; padding: 4px 12px; }
.stats {
  position: absolute; left: 12px; top: 12px; margin: 0; padding: 8px 12px; border-radius: 8px;
  background: rgb(20 20 24 / 0.8); font: 12px/1.5 ui-monospace, monospace; white-space: pre;
  pointer-events: none;
}
.stats[hidden] { display: none; }
.spinner {
  position: absolute; left: 50%; top: 50%; width: 36px; height: 36px; margin: -18px;
  border: 3px solid rgb(255 255 255 / 0.2); border-top-color: #fff; border-radius: 50%;
  animation: turn 0.9s linear infinite; pointer-events: none;
}
.spinner[hidden] { display: none; }
@keyframes turn { to { transform: rotate(1turn); } }
@media (prefers-reduced-motion: reduce) { .spinner { animation-duration: 4s; } }
@media (max-width: 520px) {
  .wide { display: none; }
  button, select { min-width: 44px; height: 44px; }
}
`;
