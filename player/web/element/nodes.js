/** Elements, icons and styles, and what viewer and device are like. */

const SVG = "http://www.w3.org/2000/svg";

/**
 * Makes an element. The player builds its DOM with such calls because a page's Trusted Types policy may forbid
 * `innerHTML`.
 * @template {keyof HTMLElementTagNameMap} T @param {T} tag
 * @param {Record<string, string | boolean | null>} [attributes] true sets an empty attribute; false and null set none
 * @param {(Node | string)[]} children @returns {HTMLElementTagNameMap[T]}
 */
export function node(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === true) made.setAttribute(name, "");
    else if (value !== false && value !== null) made.setAttribute(name, value);
  }
  made.append(...children);
  return made;
}

/** An icon. @param {string} outline its path on a grid of 24 by 24 */
export function drawn(outline) {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", "0 0 24 24");
  svg.setAttribute("aria-hidden", "true");
  const path = document.createElementNS(SVG, "path");
  path.setAttribute("d", outline);
  svg.append(path);
  return svg;
}

/** @type {Map<string, CSSStyleSheet>} shared by all elements, which may be created and removed many times */
const sheets = new Map();

/** Adds a style to the shadow tree of an element, once. @param {Node} place @param {string} style */
export function addStyle(place, style) {
  const sheet = sheets.get(style) ?? new CSSStyleSheet();
  if (!sheets.has(style)) sheet.replaceSync(style);
  sheets.set(style, sheet);
  const root = place.getRootNode();
  if (root instanceof ShadowRoot && !root.adoptedStyleSheets.includes(sheet))
    root.adoptedStyleSheets.push(sheet);
}

/** Whether the user prefers reduced motion; then nothing starts by itself. */
export function prefersStill() {
  return globalThis.matchMedia?.("(prefers-reduced-motion: reduce)").matches ?? false;
}

/** Whether this device may report its orientation. Many computers define the event but never send it. */
export function hasGyroscope() {
  const isTouched = globalThis.matchMedia?.("(pointer: coarse)").matches ?? false;
  return isTouched && globalThis.isSecureContext && "DeviceOrientationEvent" in globalThis;
}
