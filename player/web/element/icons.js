/** @param {string} path */
function icon(path) {
  return `<svg viewBox="0 0 24 24" aria-hidden="true"><path d="${path}"/></svg>`;
}

export const ICONS = {
  play: icon("M8 5v14l11-7z"),
  pause: icon("M7 5h4v14H7zm6 0h4v14h-4z"),
  loop: icon("M7 7h10v3l4-4-4-4v3H5v6h2zm10 10H7v-3l-4 4 4 4v-3h12v-6h-2z"),
  reset: icon("M12 5a7 7 0 1 1-6.7 5H3l4-5 4 5H7.4A5 5 0 1 0 12 7z"),
  stats: icon("M4 19h16v2H4zM6 11h3v7H6zm5-6h3v13h-3zm5 9h3v4h-3z"),
  share: icon("M14 9V5l7 7-7 7v-4C8 15 5 17 3 20c1-6 4-10 11-11z"),
  sideBySide: icon("M3 6h8v12H3zm2 2v8h4V8zm8-2h8v12h-8zm2 2v8h4V8z"),
  headset: icon(
    "M4 7h16a2 2 0 0 1 2 2v6a2 2 0 0 1-2 2h-4l-2.5-3h-3L8 17H4a2 2 0 0 1-2-2V9a2 2 0 0 1 2-2zm2 3v3h4v-3zm8 0v3h4v-3z",
  ),
  full: icon("M5 5h6v2H7v4H5zm14 0v6h-2V7h-4V5zM5 13h2v4h4v2H5zm12 0h2v6h-6v-2h4z"),
};
