import { SAMPLE_RATE } from "../constants.js";

/** Nobody has sounded for so long: the device may rest. */
const REST_MS = 10_000;

/** @type {AudioContext | null} one for all players of a page: browsers allow few */
let context = null;
/** @type {Set<object>} players that sound */
const users = new Set();
let timer = 0;

/** The page's audio context. A browser may keep it suspended until a person presses something. */
export function audioContext() {
  context ??= new AudioContext({ sampleRate: SAMPLE_RATE, latencyHint: "playback" });
  return context;
}

/** @param {object} user that sounds, or would but for the browser */
export function useDevice(user) {
  users.add(user);
  clearTimeout(timer);
  const device = audioContext();
  if (device.state !== "running") device.resume().catch(() => {});
}

/** @param {object} user that is silent now */
export function leaveDevice(user) {
  if (!users.delete(user) || users.size > 0) return;
  clearTimeout(timer);
  timer = setTimeout(() => context?.suspend().catch(() => {}), REST_MS);
}

/** The samples of a file, at 48000 Hz: by a context of its own, for the page's may not run. @param {ArrayBuffer} file */
export function decode(file) {
  return new OfflineAudioContext(1, 1, SAMPLE_RATE).decodeAudioData(file);
}
