import { KeyList } from "./keylist.js";
import { Menu } from "./menu.js";
import { PANEL_STYLE } from "./panelstyle.js";
import { Statistics } from "./statistics.js";

/** The panels that commands open over the picture: the menu, the statistics and the list of keys. */
export class Panels {
  /**
   * @param {import("./webplayer.js").WebPlayer} player
   * @param {HTMLElement} menuButton
   * @param {import("./menu.js").Choice[]} choices
   * @param {import("./commands.js").Command[]} commands
   * @param {import("./keys.js").KeyAction[]} actions
   * @param {() => void} changed called when the menu was opened or closed
   */
  constructor(player, menuButton, choices, commands, actions, changed) {
    this.menu = new Menu(menuButton, choices, commands, changed);
    this.statistics = new Statistics(player);
    this.keyList = new KeyList();
    this.keyList.fill(actions);
  }

  /** Whether the bar has to stay. */
  get isInUse() {
    return this.menu.isOpen || this.keyList.root.open;
  }

  /** Adds the panels to `place`, and their style to its tree. @param {HTMLElement} place */
  addTo(place) {
    const sheet = new CSSStyleSheet();
    sheet.replaceSync(PANEL_STYLE);
    const root = place.getRootNode();
    if (root instanceof ShadowRoot) root.adoptedStyleSheets.push(sheet);
    place.append(this.statistics.root, this.menu.root, this.keyList.root);
  }
}
