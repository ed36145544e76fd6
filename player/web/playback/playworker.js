/** Network and decoding, in a separate thread; see WebPlayer. */

import { FormatError } from "../format/bytes/errors.js";
import { expectEarly } from "../source/early/earlyresponses.js";
import { Fetcher, SourceError } from "../source/fetcher.js";
import { openSource } from "../source/source.js";
import { StreamPlayer } from "./streamplayer.js";
import { scope } from "./workerscope.js";

/** @type {StreamPlayer | null} */
let player = null;
/** @type {MessagePort | null} */
let sorter = null;
/** @type {import("./streamplayer.js").Start} */
let start = {};
/** @type {(() => void) | null} creates the player, for an open stream that fetches no frames yet */
let release = null;
/** URL of the stream. */
let base = "";

/** @param {unknown} error */
function fail(error) {
  const isOurs = error instanceof FormatError || error instanceof SourceError;
  const message = error instanceof Error ? error.message : String(error);
  // Viewers are not told what is wrong with the bytes: a message that has an address is a detail.
  const place = error instanceof FormatError && !/https?:/.test(message) ? `${base}: ` : "";
  scope.postMessage({
    kind: "failed",
    message: isOurs ? place + message : `The player failed: ${message}`,
  });
  release = null;
  player?.close();
  if (!isOurs) throw error;
}

/**
 * The page's request to open a stream.
 * @typedef {object} Opening
 * @property {string} base
 * @property {number} [maxGaussians]
 * @property {boolean} [otherHosts]
 * @property {RequestCredentials} [credentials]
 * @property {MessagePort} [transformRequest] see source/transform.js
 * @property {number} [bufferBytes]
 * @property {boolean} [isHeld] whether to fetch no frame until the stream plays or seeks
 */

/** @param {Opening} opening */
async function open({ maxGaussians, otherHosts, bufferBytes, isHeld, ...opening }) {
  base = opening.base;
  const { credentials, transformRequest } = opening;
  const onTrouble = (/** @type {string | null} */ message) =>
    scope.postMessage({ kind: "trouble", message });
  const onAwaited = (/** @type {string | null} */ message) =>
    scope.postMessage({ kind: "awaited", message });
  const fetcher = new Fetcher({ onTrouble, onAwaited, credentials, transformRequest });
  try {
    const most = maxGaussians ?? null;
    const stream = await openSource(base, fetcher, most, otherHosts ?? false, bufferBytes);
    const { manifest, numFrames, base: found, files } = stream;
    const opened = { manifest: plain(manifest), numFrames, base: found, files };
    scope.postMessage({ kind: "opened", ...opened });
    const port = sorter;
    if (port !== null) {
      const outlet = {
        post: (/** @type {object} */ message) => scope.postMessage(message),
        show: (/** @type {object} */ shown, /** @type {Transferable[]} */ transfer) =>
          port.postMessage(shown, transfer),
        fail,
      };
      release = () => {
        release = null;
        player = new StreamPlayer(stream, fetcher, outlet, start);
      };
      if (!isHeld) release();
    }
    await stream.follow(() => {
      scope.postMessage({
        kind: "grown",
        numFrames: stream.numFrames,
        live: stream.manifest.live,
      });
      player?.grow();
    });
  } catch (error) {
    fail(error);
  }
}

/** A manifest in a form that can be posted. @param {import("../format/manifest.js").Manifest} manifest */
function plain(manifest) {
  const { layout, ...rest } = manifest;
  return { ...rest, lattices: layout.lattices };
}

/** Keeps a setting for a player that is created later. @param {any} message */
function remember({ kind, rate, loop, most }) {
  if (kind === "rate") start.rate = rate;
  else if (kind === "loop") start.loop = loop;
  else if (kind === "layers") start.mostLayers = most;
}

scope.onmessage = ({ data }) => {
  if (data.kind === "open") {
    sorter = data.port;
    start = data.start ?? {};
    expectEarly(data.early ?? []);
    open(data);
    return;
  }
  if (player === null) remember(data);
  if (data.playing || data.kind === "seek" || data.kind === "scrub") release?.();
  switch (data.kind) {
    case "play":
      player?.setPlaying(data.playing);
      break;
    case "seek":
      player?.seek(data.frame, data.seeks);
      break;
    case "scrub":
      player?.scrub(data.frame);
      break;
    case "rate":
      player?.setRate(data.rate);
      break;
    case "loop":
      if (player !== null) player.loop = data.loop;
      break;
    case "layers":
      player?.setLayers(data.most);
      break;
    case "follow":
      player?.follow(data);
      break;
    case "ply":
      player?.postPly();
      break;
    case "resend":
      player?.resend();
      break;
  }
  player?.wake();
};
