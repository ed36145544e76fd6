/**
 * Runs in a page before its own scripts: notes when clicks leave the audio device, and when each frame
 * of the player shows, both in milliseconds of the page's clock.
 */
{
  const clicks = [];
  const shown = [];
  Object.assign(window, { clicks, shown });
  // A click is the first loud sample after 50 ms without one.
  const source = `registerProcessor("tap", class extends AudioWorkletProcessor {
    last = -1e9;
    process([input]) {
      for (let i = 0; i < (input[0]?.length ?? 0); i++) {
        const loud = Math.max(...input.map((channel) => Math.abs(channel[i])));
        if (loud < 0.2) continue;
        if (currentFrame + i - this.last > 2400) {
          this.port.postMessage({ atS: (currentFrame + i) / sampleRate, levels: input.map((channel) => channel[i]) });
        }
        this.last = currentFrame + i;
      }
      return true;
    }
  });`;
  const url = URL.createObjectURL(new Blob([source], { type: "text/javascript" }));
  const connect = AudioNode.prototype.connect;
  const taps = new Map();
  AudioNode.prototype.connect = function (to, ...rest) {
    if (to instanceof AudioDestinationNode && this.context instanceof AudioContext) {
      const { context } = this;
      if (!taps.has(context)) taps.set(context, context.audioWorklet.addModule(url));
      taps.get(context).then(() => {
        const tap = new AudioWorkletNode(context, "tap");
        tap.port.onmessage = ({ data }) => {
          const { contextTime, performanceTime } = context.getOutputTimestamp();
          clicks.push({ ...data, heardMs: performanceTime + 1000 * (data.atS - contextTime) });
        };
        connect.call(this, tap);
      });
    }
    return connect.call(this, to, ...rest);
  };
  const wait = setInterval(() => {
    const player = document.querySelector("swings-player")?.player;
    if (!player) return;
    clearInterval(wait);
    player.addEventListener("shown", () =>
      shown.push({ frame: player.shownFrame, atMs: performance.now() }),
    );
  }, 5);
}
