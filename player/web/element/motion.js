/** Whether the user prefers reduced motion; then nothing starts by itself. */
export function prefersStill() {
  return globalThis.matchMedia?.("(prefers-reduced-motion: reduce)").matches ?? false;
}

/** Whether this device may report its orientation. Many computers define the event but never send it. */
export function hasGyroscope() {
  const isTouched = globalThis.matchMedia?.("(pointer: coarse)").matches ?? false;
  return isTouched && globalThis.isSecureContext && "DeviceOrientationEvent" in globalThis;
}
