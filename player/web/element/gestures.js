/**
 * Moves the camera by pointers: one turns it around the scene, the right button or two fingers move
 * it, the wheel or pinching comes nearer. Gives a function that stops listening.
 * @param {HTMLElement} surface
 * @param {() => import("../view/orbit.js").Orbit | null} orbit
 * @param {() => number} focalPx of the picture, in CSS pixels
 * @param {() => void} moved
 */
export function listenToGestures(surface, orbit, focalPx, moved) {
  /** @type {Map<number, { x: number, y: number }>} */
  const pointers = new Map();
  const listening = new AbortController();
  const { signal } = listening;

  const middle = () => {
    const all = [...pointers.values()];
    return {
      x: all.reduce((sum, { x }) => sum + x, 0) / all.length,
      y: all.reduce((sum, { y }) => sum + y, 0) / all.length,
    };
  };
  const spreadPx = () => {
    const [a, b] = [...pointers.values()];
    return Math.max(1, Math.hypot(a.x - b.x, a.y - b.y));
  };

  surface.addEventListener(
    "pointerdown",
    (event) => {
      surface.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    },
    { signal },
  );
  surface.addEventListener(
    "pointermove",
    (event) => {
      const view = orbit();
      const before = pointers.get(event.pointerId);
      if (view === null || before === undefined || pointers.size > 2) return;
      const from = middle();
      const fromSpreadPx = pointers.size === 2 ? spreadPx() : 1;
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      const to = middle();
      if (pointers.size === 2) {
        view.dragPan(to.x - from.x, to.y - from.y, focalPx());
        view.scale(fromSpreadPx / spreadPx());
      } else if (event.buttons & 2 || event.shiftKey) {
        view.dragPan(to.x - from.x, to.y - from.y, focalPx());
      } else {
        view.dragTurn(to.x - from.x, to.y - from.y);
      }
      moved();
    },
    { signal },
  );
  for (const type of ["pointerup", "pointercancel", "lostpointercapture"]) {
    const lift = (/** @type {Event} */ event) =>
      pointers.delete(/** @type {PointerEvent} */ (event).pointerId);
    surface.addEventListener(type, lift, { signal });
  }
  surface.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      const linesPx = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 33 : 1;
      orbit()?.approach((-event.deltaY * linesPx) / 100);
      moved();
    },
    { signal, passive: false },
  );
  surface.addEventListener("contextmenu", (event) => event.preventDefault(), { signal });
  return () => listening.abort();
}
