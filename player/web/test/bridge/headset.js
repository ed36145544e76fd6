/* global IWER */
/**
 * An emulated headset, before the player loads, and what the tests ask the page. The emulator's eyes
 * see as far to each side; these see farther outwards and upwards, as those of real headsets do.
 */
const device = new IWER.XRDevice(IWER.metaQuest3, { stereoEnabled: true, visibilityMask: null });
device.installRuntime({ forceInstall: true });
const { get } = Object.getOwnPropertyDescriptor(XRView.prototype, "projectionMatrix");
Object.defineProperty(XRView.prototype, "projectionMatrix", {
  get() {
    const matrix = Float32Array.from(get.call(this));
    matrix[8] = this.eye === "left" ? -0.25 : 0.25;
    matrix[9] = 0.125;
    return matrix;
  },
});
window.device = device;
