/** The device that sound is heard from, and its clock. */

import { SAMPLE_RATE } from "../constants.js";

/** A larger difference between the clocks counts as a jump. */
const JUMP_S = 0.05;
const SHARE = 0.1;

/**
 * Relates the clock of an AudioContext, as heard, to that of the page. The device's reports are uneven, so
 * they are averaged.
 */
export class AudioClock {
  /** @type {number | null} context time of the sound heard now, minus the page's time, seconds */
  offsetS = null;

  /** @param {AudioContext} context */
  constructor(context) {
    /** @type {AudioContext} */ this.context = context;
  }

  /** Reads both clocks, and updates the offset. */
  look() {
    const foundS = this.#found();
    const differS = foundS - (this.offsetS ?? Infinity);
    if (!(Math.abs(differS) < JUMP_S)) this.offsetS = foundS;
    else this.offsetS = (this.offsetS ?? foundS) + SHARE * differS;
  }

  #found() {
    const { context } = this;
    const { contextTime, performanceTime } = context.getOutputTimestamp?.() ?? {};
    if (contextTime && performanceTime) return contextTime - performanceTime / 1000;
    const latencyS = context.outputLatency || context.baseLatency || 0;
    return context.currentTime - latencyS - performance.now() / 1000;
  }
}

/** The device is suspended after this time without sound. */
const REST_MS = 10_000;

/** @type {AudioContext | null} shared by all players of a page, because browsers allow few */
let context = null;
/** @type {Set<object>} players that play sound */
const users = new Set();
let timer = 0;
/** Whether `resume` was called since the last change of state; further calls would have no effect. */
let isAsked = false;
/** Whether there had been a user gesture in the page at that call. */
let wasActive = false;

/** The page's audio context. A browser may keep it suspended until a user gesture. */
export function audioContext() {
  if (context === null) {
    context = new AudioContext({ sampleRate: SAMPLE_RATE, latencyHint: "playback" });
    context.addEventListener("statechange", () => (isAsked = false));
  }
  return context;
}

/**
 * Runs the device for a player.
 * @param {object} user a player with sound to play, even if the browser blocks it
 * @param {boolean} [isPressed] whether this is called during a user gesture
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
  device.resume().catch((error) => console.debug(`Sound cannot start yet: ${error}`));
}

/** @param {object} user a player that is silent now */
export function leaveDevice(user) {
  if (!users.delete(user) || users.size > 0) return;
  clearTimeout(timer);
  timer = setTimeout(() => {
    isAsked = false;
    context?.suspend().catch((error) => console.debug(`Sound does not rest: ${error}`));
  }, REST_MS);
}

/** Decodes a file at 48000 Hz, in a separate context: the page's may not run. @param {ArrayBuffer} file */
export function decode(file) {
  return new OfflineAudioContext(1, 1, SAMPLE_RATE).decodeAudioData(file);
}
