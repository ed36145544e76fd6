import { SAMPLE_RATE } from "../constants.js";

/** Nobody has sounded for so long: the device may rest. */
const REST_MS = 10_000;

/** @type {AudioContext | null} one for all players of a page: browsers allow few */
let context = null;
/** @type {Set<object>} players that sound */
const users = new Set();
let timer = 0;
/** Whether it was asked to run since its state changed last: more of that says nothing new to a browser. */
let isAsked = false;
/** Whether a person had pressed anything in the page when it was asked. */
let wasActive = false;

/** The page's audio context. A browser may keep it suspended until a person presses something. */
export function audioContext() {
  if (context === null) {
    context = new AudioContext({ sampleRate: SAMPLE_RATE, latencyHint: "playback" });
    context.addEventListener("statechange", () => (isAsked = false));
  }
  return context;
}

/**
 * @param {object} user that sounds, or would but for the browser
 * @param {boolean} [isPressed] whether a person presses something just now
 */
export function useDevice(user, isPressed = false) {
  users.add(user);
  clearTimeout(timer);
  const device = audioContext();
  if (device.state === "running") return;
  const isActive = navigator.userActivation?.hasBeenActive ?? false;
  if (isAsked && !isPressed && isActive === wasActive) return;
  isAsked = true;
  wasActive = isActive;
  device.resume().catch(() => {});
}

/** @param {object} user that is silent now */
export function leaveDevice(user) {
  if (!users.delete(user) || users.size > 0) return;
  clearTimeout(timer);
  timer = setTimeout(() => {
    isAsked = false;
    context?.suspend().catch(() => {});
  }, REST_MS);
}

/** The samples of a file, at 48000 Hz: by a context of its own, for the page's may not run. @param {ArrayBuffer} file */
export function decode(file) {
  return new OfflineAudioContext(1, 1, SAMPLE_RATE).decodeAudioData(file);
}
