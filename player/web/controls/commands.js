/**
 * The commands of a player with their keys, for the bar, the menu and the list of keys; and the settings
 * that have a list of values.
 */

import { isPacked } from "../source/addresses.js";
import { RATES } from "./keys.js";

/**
 * The settings of a player that have a list of values, for the bar and the menu.
 * @param {import("../element/swingsplayer.js").SwingsPlayerElement} element
 * @param {import("./texts.js").Translate} t @returns {import("./menu.js").Choice[]}
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
        ...[...Array(element.numLayers).keys()]
          .map((n) => ({ value: n + 1, label: layerText(n + 1) }))
          .reverse(),
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

/**
 * An action of the player that has a button in the bar, an entry in the menu or a key.
 * @typedef {object} Command
 * @property {string} name class of its button in the bar
 * @property {string} label
 * @property {import("./bar.js").IconName} [icon] for the bar; icons of menu-only commands are in menu.js
 * @property {string} key name as in keyboard events, in lower case
 * @property {boolean} [isInBar] whether it is in the bar while there is room, and else in the menu
 * @property {() => boolean} [isThere] whether this stream on this device has it; by default it has
 * @property {() => void} run
 * @property {() => boolean} [isOn] for toggles: whether it is on
 */

/**
 * The commands of a player, in the order of the bar and of the menu.
 * @param {import("../element/swingsplayer.js").SwingsPlayerElement} element
 * @param {import("./stereocontrols.js").StereoControls} stereo @param {import("./sharing.js").Sharing} sharing
 * @param {() => import("./panels.js").Panels} panels which are made of the commands @returns {Command[]}
 */
export function commandsOf(element, stereo, sharing, panels) {
  const hasTime = () => !element.player?.isStill;
  const canLoop = () => hasTime() && !element.player?.live;
  return [
    {
      name: "share",
      label: "Share this moment and view",
      icon: "share",
      key: "",
      isInBar: true,
      run: () => sharing.share(),
    },
    {
      name: "reset",
      label: "Reset the view",
      icon: "reset",
      key: "r",
      isInBar: true,
      run: () => element.resetView(),
    },
    {
      name: "loop",
      label: "Loop",
      key: "o",
      isThere: canLoop,
      run: () => canLoop() && element.toggleLoop(),
      isOn: () => element.isLooping,
    },
    {
      name: "fly",
      label: "Fly through the scene",
      key: "g",
      isThere: () => matchMedia("(any-pointer: fine)").matches,
      run: () => element.toggleFlying(),
      isOn: () => element.player?.motion?.isFlying ?? false,
    },
    {
      name: "interpolate",
      label: "Motion between frames",
      key: "b",
      isThere: hasTime,
      run: () => (element.interpolate = !element.interpolate),
      isOn: () => element.interpolate,
    },
    ...(element.hasGyroscope ? [gyroscopeOf(element)] : []),
    {
      name: "side-by-side",
      label: "Side-by-side stereo view",
      key: "e",
      run: () => stereo.toggleSideBySide(),
      isOn: () => stereo.isSideBySide,
    },
    {
      name: "pip",
      label: "Picture in picture",
      key: "",
      isThere: () => document.pictureInPictureEnabled ?? false,
      run: () => sharing.openPictureInPicture(),
    },
    {
      name: "download",
      label: "Download the video",
      key: "",
      isThere: () => fileOf(element) !== null,
      run: () => sharing.download(fileOf(element) ?? ""),
    },
    {
      name: "save",
      label: "Download this picture",
      key: "",
      run: () => sharing.savePicture(),
    },
    {
      name: "save-frame",
      label: "Download this frame as PLY",
      key: "",
      run: () => sharing.saveFrame(),
    },
    {
      name: "embed",
      label: "Copy the embed code",
      key: "",
      run: () => sharing.copyEmbedCode(),
    },
    {
      name: "statistics",
      label: "Statistics",
      key: "i",
      run: () => element.toggleStats(),
      isOn: () => panels().statistics.isOn,
    },
    {
      name: "keys",
      label: "Keys",
      key: "?",
      isThere: () => matchMedia("(any-pointer: fine)").matches,
      run: () => panels().keyList.toggle(),
    },
    {
      name: "headset",
      label: "Show on the VR headset",
      icon: "headset",
      key: "v",
      isInBar: true,
      isThere: () => stereo.isThere,
      run: () => stereo.toggleHeadset(),
      isOn: () => stereo.isWorn,
    },
  ];
}

/**
 * URL of the stream as one file; null if it has none, or none yet.
 * @param {import("../element/swingsplayer.js").SwingsPlayerElement} element
 */
function fileOf(element) {
  const { currentSrc, player } = element;
  if (!player?.manifest || player.live) return null;
  const url = element.getAttribute("download");
  if (url !== null) return new URL(url, document.baseURI).href;
  return isPacked(currentSrc) ? currentSrc : null;
}

/**
 * The gyroscope command; on phones only.
 * @param {import("../element/swingsplayer.js").SwingsPlayerElement} element @returns {Command}
 */
function gyroscopeOf(element) {
  return {
    name: "gyroscope",
    label: "Look around by turning the phone",
    key: "",
    run: () => element.toggleGyroscope(),
    isOn: () => element.isGyroscopeOn,
  };
}
