/**
 * Features that many viewers never use. Everything here is loaded by `import()`: a bundle has it in a
 * separate file, which does not delay the first picture.
 */

export { Headset } from "../stereo/headset.js";
export { Panels } from "./panels.js";
export { Sharing } from "./sharing.js";
export { SlideShow } from "./slideshow.js";
export { Storyboard } from "./storyboard.js";
