/** Whether the user prefers reduced motion; then nothing starts by itself. */
export function prefersStill() {
  return globalThis.matchMedia?.("(prefers-reduced-motion: reduce)").matches ?? false;
}
