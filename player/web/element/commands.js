/**
 * An action of the player that has a button in the bar, an entry in the menu or a key.
 * @typedef {object} Command
 * @property {string} name class of its button in the bar
 * @property {string} label
 * @property {import("./icons.js").IconName} [icon] for the bar; icons of menu-only commands are in menu.js
 * @property {string} key name as in keyboard events, in lower case
 * @property {"bar" | "wide" | "menu"} place in the bar; in a wide bar, otherwise in the menu; in the menu
 * @property {() => void} run
 * @property {() => boolean} [isOn] for toggles: whether it is on
 */

/**
 * The commands of a player, in the order of the bar and of the menu.
 * @param {import("./swingsplayer.js").SwingsPlayerElement} element
 * @param {import("./stereocontrols.js").StereoControls} stereo
 * @param {import("./lazypart.js").LazyPart<import("./sharing.js").Sharing>} sharing
 * @param {import("./lazypart.js").LazyPart<import("./panels.js").Panels>} panels
 * @returns {Command[]}
 */
export function commandsOf(element, stereo, sharing, panels) {
  return [
    {
      name: "share",
      label: "Share this moment and view",
      icon: "share",
      key: "",
      place: "wide",
      run: () => sharing.use((part) => part.share()),
    },
    {
      name: "embed",
      label: "Copy the embed code",
      key: "",
      place: "menu",
      run: () => sharing.use((part) => part.copyEmbedCode()),
    },
    {
      name: "loop",
      label: "Loop",
      icon: "loop",
      key: "o",
      place: "wide",
      run: () => element.toggleLoop(),
      isOn: () => element.isLooping,
    },
    {
      name: "reset",
      label: "Reset the view",
      icon: "reset",
      key: "r",
      place: "wide",
      run: () => element.resetView(),
    },
    {
      name: "side-by-side",
      label: "Side-by-side stereo view",
      icon: "sideBySide",
      key: "e",
      place: "wide",
      run: () => stereo.toggleSideBySide(),
      isOn: () => stereo.isSideBySide,
    },
    {
      name: "interpolate",
      label: "Motion between frames",
      key: "b",
      place: "menu",
      run: () => (element.interpolate = !element.interpolate),
      isOn: () => element.interpolate,
    },
    ...(element.hasGyroscope ? [gyroscopeOf(element)] : []),
    {
      name: "statistics",
      label: "Statistics",
      key: "i",
      place: "menu",
      run: () => element.toggleStats(),
      isOn: () => panels.part?.statistics.isOn ?? false,
    },
    {
      name: "keys",
      label: "Keys",
      key: "?",
      place: "menu",
      run: () => panels.use(({ keyList }) => keyList.toggle()),
    },
    {
      name: "headset",
      label: "Show on the VR headset",
      icon: "headset",
      key: "v",
      place: "bar",
      run: () => stereo.toggleHeadset(),
      isOn: () => stereo.isWorn,
    },
  ];
}

/**
 * The gyroscope command; on phones only.
 * @param {import("./swingsplayer.js").SwingsPlayerElement} element
 * @returns {Command}
 */
function gyroscopeOf(element) {
  return {
    name: "gyroscope",
    label: "Look around by turning the phone",
    key: "",
    place: "menu",
    run: () => element.toggleGyroscope(),
    isOn: () => element.isGyroscopeOn,
  };
}
