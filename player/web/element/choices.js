import { RATES } from "./keys.js";

/**
 * The speed and the quality of a player, for the bar and the menu.
 * @param {import("./mediainterface.js").MediaInterface} element
 * @returns {import("./menu.js").Choice[]}
 */
export function choicesOf(element) {
  const layerText = (/** @type {number} */ n) => (n === 1 ? "1 layer" : `${n} layers`);
  const rates = RATES.map((value) => ({ value, label: `${value}×` }));
  return [
    {
      name: "rate",
      label: "Speed",
      values: () => rates,
      now: () => element.playbackRate,
      choose: (rate) => (element.playbackRate = rate),
    },
    {
      name: "quality",
      label: "Quality",
      values: () => [
        { value: 0, label: "Auto" },
        ...Array.from({ length: element.numLayers }, (_, n) => element.numLayers - n).map(
          (value) => ({
            value,
            label: layerText(value),
          }),
        ),
      ],
      now: () => element.layers,
      choose: (layers) => (element.layers = layers),
    },
  ];
}
