/** The menu, the statistics and the list of keys. */
export const PANEL_STYLE = /* css */ `
.stats {
  position: absolute; left: 12px; top: 12px; margin: 0; padding: 8px 12px; border-radius: 8px;
  max-width: calc(100% - 48px); overflow: hidden; background: rgb(20 20 24 / 0.8);
  font-family: ui-monospace, monospace; font-size: clamp(12px, 0.65cqw, 18px); white-space: pre;
  pointer-events: none;
}
.menu {
  --under: calc(var(--button) + max(var(--least-scrub), var(--button) * 0.5) + 12px);
  position: absolute; right: 12px; bottom: var(--under); box-sizing: border-box;
  min-width: 15em; max-width: calc(100% - 24px); max-height: calc(100% - var(--under) - 8px);
  overflow: auto; padding: 6px; border-radius: 10px; background: var(--panel);
  box-shadow: 0 4px 24px rgb(0 0 0 / 0.5);
}
.menu button { display: flex; align-items: center; gap: 0.8em; width: 100%; min-height: max(36px, var(--least)); padding: 0 10px; text-align: left; }
.menu svg { flex: none; }
.menu span { flex: 1; }
.menu .value { flex: none; color: #b9b9c2; }
.menu [role="menuitemradio"]::before, .menu [role="menuitemcheckbox"]::after { content: "✓"; width: 1em; visibility: hidden; }
.menu [aria-checked="true"]::before, .menu [aria-checked="true"]::after { visibility: visible !important; }
.menu .back { border-bottom: 1px solid rgb(255 255 255 / 0.2); border-radius: 6px 6px 0 0; font-weight: 600; }
kbd {
  padding: 1px 6px; border: 1px solid rgb(255 255 255 / 0.35); border-radius: 4px;
  font: inherit; font-size: 0.9em; color: #d6d6dc;
}
/* A low player has no room for both. */
@container (max-height: 260px) { .menu { --under: 4px; } }
@media (pointer: coarse) { .menu kbd { display: none; } }
.keylist {
  box-sizing: border-box; width: min(92vw, 46rem); max-height: 88vh; padding: 1.2rem 1.6rem;
  border: 0; border-radius: 12px; background: #1c1c20; color: #e8e8ea; font-size: max(13px, 0.9rem);
}
.keylist::backdrop { background: rgb(0 0 0 / 0.6); }
.keylist header { display: flex; justify-content: space-between; align-items: center; margin-bottom: 0.8rem; }
.keylist h2 { margin: 0; font-size: 1.2em; }
.keylist dl { margin: 0; columns: 20rem; column-gap: 2rem; }
.keylist dl div { display: flex; gap: 1em; padding: 4px 0; break-inside: avoid; }
.keylist dt { flex: 0 0 6em; display: flex; gap: 4px; align-items: start; }
.keylist dd { margin: 0; }
.keylist .close { min-height: max(36px, var(--least)); padding: 0 1.4em; background: #e8e8ea; color: #111; font-weight: 600; }
@media (forced-colors: active) {
  .menu, .keylist, .stats { border: 1px solid CanvasText; background: Canvas; }
  :is(.stats, .menu span, .menu .value, .keylist *) { color: CanvasText; background-color: Canvas; }
}
`;
