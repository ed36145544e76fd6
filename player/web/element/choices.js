import { RATES } from "./keys.js";

/**
 * The settings of a player that have a list of values, for the bar and the menu.
 * @param {import("./swingsplayer.js").SwingsPlayerElement} element
 * @returns {import("./menu.js").Choice[]}
 */
export function choicesOf(element) {
  const layerText = (/** @type {number} */ n) => (n === 1 ? "1 layer" : `${n} layers`);
  const rates = RATES.map((value) => ({ value, label: `${value}×` }));
  const hasTime = () => !element.player?.isStill;
  return [
    {
      name: "rate",
      label: "Speed",
      isInBar: true,
      isThere: hasTime,
      values: () => rates,
      now: () => element.playbackRate,
      choose: (rate) => (element.playbackRate = rate),
    },
    {
      name: "quality",
      label: "Quality",
      isInBar: true,
      isThere: () => element.numLayers !== 1,
      values: () => [
        { value: 0, label: "Auto" },
        ...Array.from({ length: element.numLayers }, (_, n) => element.numLayers - n).map(
          (value) => ({ value, label: layerText(value) }),
        ),
      ],
      now: () => element.layers,
      choose: (layers) => (element.layers = layers),
    },
    {
      name: "views",
      label: "Cameras",
      isThere: () => element.cameras.length > 1,
      values: () => element.cameras.map((label, value) => ({ value, label })),
      now: () => element.player?.motion?.cameraIndex ?? 0,
      choose: (index) => element.flyToCamera(index),
    },
  ];
}
