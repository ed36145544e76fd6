/** Whether the person has asked the device for less motion: nothing then starts by itself. */
export function prefersStill() {
  return globalThis.matchMedia?.("(prefers-reduced-motion: reduce)").matches ?? false;
}
