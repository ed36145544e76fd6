/** Network and decoding, in a separate thread; see WebPlayer. */

import { FormatError } from "../format/bytes.js";
import { expectEarly } from "../source/early.js";
import { Fetcher, SourceError } from "../source/fetcher.js";
import { openSource } from "../source/source.js";
import { PlayController } from "./playcontroller.js";

/** @typedef {import("./messages.js").FromPlayer} FromPlayer */
/** @typedef {import("./messages.js").ToPlayer} ToPlayer */

const scope = /** @type {import("./messages.js").Channel<FromPlayer, ToPlayer>} */ (
  /** @type {unknown} */ (self)
);

/** @type {PlayController | null} */
let player = null;
/** @type {MessagePort | null} to the worker that takes the frames */
let sink = null;
/** @type {import("./messages.js").Start} */
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

/** @param {import("./messages.js").Opening} opening */
async function open(opening) {
  const { maxGaussians, otherHosts, credentials, transformRequest, bufferBytes, isHeld } = opening;
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
    const port = sink;
    if (port !== null) {
      /** @type {import("./playcontroller.js").Outlet} */
      const outlet = {
        post: (message) => scope.postMessage(message),
        show: (shown, transfer) => port.postMessage(shown, transfer),
        fail,
      };
      release = () => {
        release = null;
        player = new PlayController(stream, fetcher, outlet, start);
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

/** Keeps a setting for a player that is created later. @param {ToPlayer} message */
function remember(message) {
  if (message.kind === "rate") start.rate = message.rate;
  else if (message.kind === "loop") start.loop = message.loop;
  else if (message.kind === "layers") start.mostLayers = message.most;
}

scope.onmessage = (/** @type {MessageEvent<ToPlayer>} */ { data }) => {
  if (data.kind === "open") {
    base = data.base;
    sink = data.port ?? null;
    start = data.start ?? {};
    expectEarly(data.early ?? []);
    open(data);
    return;
  }
  if (player === null) remember(data);
  const isPlay = data.kind === "play" && data.playing;
  if (isPlay || data.kind === "seek" || data.kind === "scrub") release?.();
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
