/** Reads the text and times of WebVTT (FORMAT.md, section 15). */

import { MAX_CAPTIONS } from "../constants.js";
import { corrupt } from "./bytes.js";
import { field, list, text } from "./json.js";

const TIME = "(?:(\\d{2,}):)?([0-5]\\d):([0-5]\\d)\\.(\\d{3})";
const TIMING = new RegExp(`^[ \\t]*${TIME}[ \\t]*-->[ \\t]*${TIME}(?:[ \\t].*)?$`);
/** Named escapes and what they stand for. */
const known = new Map(
  Object.entries({ amp: "&", lt: "<", gt: ">", nbsp: "\u00a0", lrm: "\u200e", rlm: "\u200f" }),
);
/** HTML has 2,231 names. A file of others would keep the page busy for seconds. */
const MOST_KNOWN = 4096;

/**
 * A text that shows from `startS` until before `endS`.
 * @typedef {object} Cue
 * @property {number} startS @property {number} endS @property {string} text
 */

/** The cues of a file, in order; null if it is not WebVTT. @param {string} file @returns {Cue[] | null} */
export function readCues(file) {
  const lines = file.replace(/^\ufeff/, "").split(/\r\n|\r|\n/);
  if (!/^WEBVTT(?:[ \t].*)?$/.test(lines[0])) return null;
  const cues = /** @type {Cue[]} */ ([]);
  for (let at = 1; at < lines.length; ) {
    const found = TIMING.exec(lines[at++]);
    if (found === null) continue;
    const begin = at;
    while (at < lines.length && lines[at] !== "" && !lines[at].includes("-->")) at += 1;
    const startS = seconds(found.slice(1, 5));
    const endS = seconds(found.slice(5));
    const text = plain(lines.slice(begin, at).join("\n")).trim();
    if (startS < endS && text !== "") cues.push({ startS, endS, text });
  }
  return cues;
}

/** @param {string[]} parts */
function seconds(parts) {
  const [hours, minutes, rest, thousandths] = parts.map((part) => Number(part ?? 0));
  return 3600 * hours + 60 * minutes + rest + thousandths / 1000;
}

/** Removes tags and resolves escapes. @param {string} text */
function plain(text) {
  return text
    .replace(/<[^>]*>?/g, "")
    .replace(/&(?:#(\d+)|#x([\da-f]+)|[a-z][a-z\d]*);/gi, (escape, ten, sixteen) => {
      if (ten || sixteen) return character(parseInt(ten ?? sixteen, ten ? 10 : 16));
      return known.get(escape.slice(1, -1)) ?? named(escape);
    });
}

/** @param {number} code */
function character(code) {
  const isOne = code > 0 && code <= 0x10ffff && (code < 0xd800 || code > 0xdfff);
  return isOne ? String.fromCodePoint(code) : "\ufffd";
}

/** Resolves a named escape with the browser's caption parser, which runs no code. @param {string} escape */
function named(escape) {
  if (typeof VTTCue === "undefined" || known.size >= MOST_KNOWN) return escape;
  const text = new VTTCue(0, 1, escape).getCueAsHTML().textContent ?? escape;
  known.set(escape.slice(1, -1), text);
  return text;
}

/** The text that shows at a time, one cue below the other. @param {Cue[]} cues @param {number} timeS */
export function textAt(cues, timeS) {
  return cues
    .filter(({ startS, endS }) => startS <= timeS && timeS < endS)
    .map(({ text }) => text)
    .join("\n");
}

/**
 * @typedef {object} CaptionTrack
 * @property {string} language @property {string} label
 * @property {string} file beside the manifest
 */

/** The caption tracks in a manifest. Throws a FormatError. @param {unknown} value @returns {CaptionTrack[]} */
export function readCaptionTracks(value) {
  const tracks = list(value, 0, MAX_CAPTIONS, "captions").map((one) => {
    const language = text(field(one, "language"), "language");
    if (!/^[A-Za-z0-9]{1,8}(?:-[A-Za-z0-9]{1,8}){0,3}$/.test(language))
      throw corrupt("manifest: captions have no such language");
    const label = text(field(one, "label"), "label");
    if (!/^(?:[^\p{C}\p{Z}]| ){1,80}$/u.test(label))
      throw corrupt("manifest: a label of captions is not 1 to 80 printable characters");
    return { language, label, file: `captions-${language}.vtt` };
  });
  if (new Set(tracks.map(({ language }) => language.toLowerCase())).size !== tracks.length)
    throw corrupt("manifest: two captions have the same language");
  return tracks;
}
