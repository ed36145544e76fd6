import "swings-player";
import { SwingsPlayerElement } from "swings-player";
import { GaussianFeed } from "swings-player/feed";
import { Fetcher, openSource, Playback, FrameAssembler } from "swings-player/core";

const player: SwingsPlayerElement = document.createElement("swings-player");
player.preload = "metadata";
const playing: Promise<void> = player.play();
const end: number = player.buffered.end(0);
player.requestVideoFrameCallback((nowMs: number, { mediaTime }) => nowMs + mediaTime);
const media: MediaStream = player.captureStream(30);
const feed = new GaussianFeed("stream", { otherHosts: true });
const means: Float32Array = feed.gaussians.means;
const numGs: Promise<number> = feed.opened.then((stream) => stream.numGs);
const fps: Promise<number> = openSource("stream/", new Fetcher()).then(({ manifest }) => {
  new Playback(new FrameAssembler(manifest), manifest.fps, 1, 0);
  return manifest.fps;
});
// @ts-expect-error: no such mode
player.preload = "everything";
// @ts-expect-error: a number of seconds
player.currentTime = "1";
export { playing, end, media, means, numGs, fps };
