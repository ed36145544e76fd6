import { drawn } from "./nodes.js";

/** Icon paths on a grid of 24 by 24; icons that only the menu uses are in menu.js. */
const PATHS = {
  play: "M8 5v14l11-7z",
  pause: "M7 5h4v14H7zm6 0h4v14h-4z",
  reset: "M12 3l9.5 8.5H19V20h-5.5v-6h-3v6H5v-8.5H2.5z",
  share: "M14 9V5l7 7-7 7v-4C8 15 5 17 3 20c1-6 4-10 11-11z",
  headset:
    "M4 7h16a2 2 0 0 1 2 2v6a2 2 0 0 1-2 2h-4l-2.5-3h-3L8 17H4a2 2 0 0 1-2-2V9a2 2 0 0 1 2-2zm2 3v3h4v-3zm8 0v3h4v-3z",
  menu: "M12 4a2 2 0 1 1 0 4 2 2 0 0 1 0-4zm0 6a2 2 0 1 1 0 4 2 2 0 0 1 0-4zm0 6a2 2 0 1 1 0 4 2 2 0 0 1 0-4z",
  full: "M5 5h6v2H7v4H5zm14 0v6h-2V7h-4V5zM5 13h2v4h4v2H5zm12 0h2v6h-6v-2h4z",
  window: "M9 5h2v6H5V9h4zm4 0h2v4h4v2h-6zm-8 8h6v6H9v-4H5zm8 0h6v2h-4v4h-2z",
};

/** @typedef {keyof typeof PATHS} IconName */

/** @param {IconName} name */
export function icon(name) {
  return drawn(PATHS[name]);
}
