/** What a device's lock screen and media keys offer for a player. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { RemoteControl } from "../controls/tracks.js";
import { settled } from "./support.mjs";

/** An element that plays, and its player. */
function playing(context, changes = {}, manifest = {}) {
  const element = new EventTarget();
  const said = [];
  const play = () => said.push("play");
  Object.assign(element, { paused: false, muted: false, volume: 1, duration: 20, currentTime: 5 });
  Object.assign(element, { playbackRate: 1, poster: "", play, pause: () => said.push("pause") });
  Object.assign(element, changes);
  const described = { title: "A walk", sound: [{}], poster: "art/one.jpg", ...manifest };
  const player = { manifest: described, base: "http://host/clip/", files: null, live: false };
  const ending = new AbortController();
  context.after(() => ending.abort());
  const control = new RemoteControl(element, player, ending.signal);
  const fires = (type, more = {}) => {
    Object.assign(element, more);
    element.dispatchEvent(new Event(type));
  };
  return { element, player, control, said, ending, fires };
}

/** The media session of a page. */
function session() {
  const actions = {};
  const positions = [];
  const mediaSession = {
    metadata: null,
    playbackState: "none",
    setActionHandler: (name, run) => (actions[name] = run),
    setPositionState: (state) => positions.push(state),
  };
  Object.defineProperty(globalThis, "navigator", { value: { mediaSession }, configurable: true });
  globalThis.document = { title: "The page" };
  globalThis.MediaMetadata = class {
    constructor(fields) {
      Object.assign(this, fields);
    }
  };
  return { mediaSession, actions, positions };
}

test("a player that is heard is named, and obeys the keys of the device", async (context) => {
  const { mediaSession, actions, positions } = session();
  const { element, said, fires, ending } = playing(context);
  fires("play");
  await settled();
  const artwork = [{ src: "http://host/clip/art/one.jpg" }];
  assert.deepEqual({ ...mediaSession.metadata }, { title: "A walk", artwork });
  assert.equal(mediaSession.playbackState, "playing");
  assert.deepEqual(positions.at(-1), { duration: 20, position: 5, playbackRate: 1 });
  actions.pause({});
  actions.play({});
  assert.deepEqual(said, ["pause", "play"]);
  const places = [
    ["seekto", { seekTime: 7 }, 7],
    ["seekforward", {}, 17],
    ["seekforward", { seekOffset: 5 }, 20],
    ["seekbackward", { seekOffset: 30 }, 0],
  ];
  for (const [name, details, timeS] of places) {
    actions[name](details);
    assert.equal(element.currentTime, timeS);
  }
  fires("pause", { paused: true });
  assert.equal(mediaSession.playbackState, "paused");
  ending.abort();
  assert.deepEqual([mediaSession.metadata, mediaSession.playbackState], [null, "none"]);
  assert.ok(Object.values(actions).every((run) => run === null));
});

test("a player that is not heard leaves the device alone, and the last one heard has it", async (context) => {
  const { mediaSession, actions, positions } = session();
  for (const [changes, manifest] of [
    [{ muted: true }],
    [{ volume: 0 }],
    [{ paused: true }],
    [{}, { sound: undefined }],
  ]) {
    playing(context, changes, manifest).fires("play");
    assert.equal(mediaSession.metadata, null);
  }
  const first = playing(context, { muted: true, poster: "http://page/mine.jpg" }, { title: "" });
  first.fires("play");
  first.fires("volumechange", { muted: false });
  await settled();
  const artwork = [{ src: "http://page/mine.jpg" }];
  assert.deepEqual({ ...mediaSession.metadata }, { title: "The page", artwork });
  const second = playing(context, {}, { poster: null });
  second.player.live = true;
  second.fires("play");
  await settled();
  assert.deepEqual({ ...mediaSession.metadata }, { title: "A walk" });
  assert.equal(positions.at(-1), undefined, "a live stream has no length");
  first.fires("pause", { paused: true });
  first.fires("emptied");
  assert.deepEqual([mediaSession.playbackState, actions.play === null], ["playing", false]);
});
