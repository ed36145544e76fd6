import { RATES } from "./keys.js";

/**
 * The settings of a player that have a list of values, for the bar and the menu.
 * @param {import("./swingsplayer.js").SwingsPlayerElement} element
 * @param {import("./texts.js").Translate} t
 * @returns {import("./menu.js").Choice[]}
 */
export function choicesOf(element, t) {
  const layerText = (/** @type {number} */ n) =>
    n === 1 ? t("1 layer") : t("{count} layers", { count: String(n) });
  const rates = RATES.map((value) => ({ value, label: `${value}×` }));
  const hasTime = () => !element.player?.isStill;
  return [
    {
      name: "rate",
      label: t("Speed"),
      isInBar: true,
      isThere: hasTime,
      values: () => rates,
      now: () => element.playbackRate,
      choose: (rate) => (element.playbackRate = rate),
    },
    {
      name: "quality",
      label: t("Quality"),
      isInBar: true,
      isThere: () => element.numLayers !== 1,
      values: () => [
        { value: 0, label: t("Auto") },
        ...Array.from({ length: element.numLayers }, (_, n) => element.numLayers - n).map(
          (value) => ({ value, label: layerText(value) }),
        ),
      ],
      now: () => element.layers,
      choose: (layers) => (element.layers = layers),
    },
    {
      name: "views",
      label: t("Cameras"),
      isThere: () => element.cameras.length > 1,
      values: () => element.cameras.map((label, value) => ({ value, label })),
      now: () => element.player?.motion?.cameraIndex ?? 0,
      choose: (index) => element.flyToCamera(index),
    },
  ];
}
