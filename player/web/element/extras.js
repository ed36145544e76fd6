/**
 * What many viewers never use. Everything here is loaded by `import()`: a bundle has it in a file of its
 * own, which no first picture waits for.
 */

export { Headset } from "../stereo/headset.js";
export { Panels } from "./panels.js";
export { Sharing } from "./sharing.js";
export { Storyboard } from "./storyboard.js";
