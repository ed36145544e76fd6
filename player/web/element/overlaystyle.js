/** Style of the poster, messages and large button over the picture. */
export const OVERLAY_STYLE = /* css */ `
/* In a low player, the bar leaves the middle of what is above it. */
.large, .spinner { --at: calc((100% - var(--under, 0px)) / 2); }
/* It lies as the first picture will, see view/framing.js; but a mean of two lengths is no square root. */
.poster {
  --ratio: var(--aspect, 1.778);
  --high: min(100cqh, max(75cqh, 50cqh + 50cqw / var(--ratio)));
  --wide: min(100cqw, var(--high) * var(--ratio));
  --whole: calc(var(--high) * var(--ratio));
  position: absolute; inset-inline: 0; top: calc((100cqh - var(--high)) / 4); margin-inline: auto;
  width: var(--wide); height: var(--high); object-fit: cover;
  object-position: clamp(var(--wide) - var(--whole), var(--wide) / 2 - var(--focus, 0.5) * var(--whole), 0px) 0;
  pointer-events: none; transition: opacity 0.3s;
}
.poster.gone { opacity: 0; }
.large {
  --size: clamp(64px, 9cqmin, 120px);
  position: absolute; left: 50%; top: var(--at); translate: -50% -50%; padding: 0;
  width: var(--size); height: var(--size); border-radius: 50%; background: rgb(20 20 24 / 0.75);
}
.large:hover { background: rgb(60 60 68 / 0.9); }
.large svg { width: 55%; height: 55%; }
/* The ring appears after a delay: a quick start shows none, and need not draw it beside the first picture. */
.spinner {
  --after: 0.8s;
  position: absolute; left: 50%; top: var(--at); translate: -50% -50%; pointer-events: none; text-align: center;
  visibility: hidden; animation: appear 0s var(--after) forwards;
}
.ring {
  display: block; width: clamp(36px, 5cqmin, 64px); aspect-ratio: 1; box-sizing: border-box;
  border: 3px solid rgb(255 255 255 / 0.25); border-top-color: #fff; border-radius: 50%;
  animation: turn 0.9s linear var(--after) infinite;
}
.spinner .label { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); }
@keyframes appear { to { visibility: visible; } }
@keyframes turn { to { transform: rotate(1turn); } }
.note.soft {
  position: absolute; inset-inline: 0; top: max(12px, env(safe-area-inset-top), var(--messages-top, 0px)); margin-inline: auto;
  width: fit-content; max-width: min(80%, 40em); box-sizing: border-box;
  padding: 4px 12px; border-radius: 8px; background: var(--panel); text-align: center;
  overflow-wrap: anywhere; pointer-events: none;
}
.note.soft:empty { display: none; }
@media (forced-colors: active) {
  .note.soft, .large { border: 1px solid CanvasText; background: Canvas; }
  .ring { border-color: GrayText; border-top-color: Highlight; forced-color-adjust: none; }
}
@media (prefers-reduced-motion: reduce) {
  .ring { animation: none; display: none; }
  .spinner .label { position: static; width: auto; height: auto; clip-path: none; padding: 6px 14px; border-radius: 8px; background: var(--panel); }
}
`;
