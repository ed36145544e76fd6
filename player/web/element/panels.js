import { KeyList } from "./keylist.js";
import { Menu } from "./menu.js";
import { addStyle } from "./nodes.js";
import PANEL_STYLE from "./panels.css";
import { Statistics } from "./statistics.js";

/** Shared by all elements. */
const SHEET = new CSSStyleSheet();
SHEET.replaceSync(PANEL_STYLE);

/** The panels that commands open over the picture: the menu, the statistics and the list of keys. */
export class Panels {
  /**
   * @param {import("./webplayer.js").WebPlayer} player
   * @param {HTMLElement} place
   * @param {object} parts
   * @param {import("./bar.js").Bar} parts.bar
   * @param {import("./menu.js").Choice[]} parts.choices
   * @param {import("./commands.js").Command[]} parts.commands
   * @param {import("./keys.js").KeyAction[]} parts.actions
   * @param {import("./texts.js").Translate} t
   * @param {() => void} changed called when the menu was opened or closed
   */
  constructor(player, place, { bar, choices, commands, actions }, t, changed) {
    this.menu = new Menu(bar, choices, commands, t, changed);
    this.statistics = new Statistics(player);
    this.keyList = new KeyList(actions, t);
    addStyle(place, SHEET);
    place.append(this.statistics.root, this.menu.root, this.keyList.root);
  }

  /** Whether the bar has to stay. */
  get isInUse() {
    return this.menu.isOpen || this.keyList.root.open;
  }
}
