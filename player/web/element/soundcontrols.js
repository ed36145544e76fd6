import { drawn, node } from "./nodes.js";

const SPEAKER = "M3 9v6h4l5 5V4L7 9z";
const ICONS = {
  heard: `${SPEAKER}M14 7.5v9a5 5 0 0 0 0-9z`,
  silent: `${SPEAKER}M15.4 8L14 9.4l2.6 2.6-2.6 2.6 1.4 1.4 2.6-2.6 2.6 2.6 1.4-1.4-2.6-2.6L22 9.4 20.6 8 18 10.6z`,
};

/** Mute and volume in the bar, and a button over the picture if the browser requires a user gesture. */
export class SoundControls {
  /**
   * @param {import("./mediainterface.js").MediaInterface} element
   * @param {import("./texts.js").Translate} t
   */
  constructor(element, t) {
    this.element = element;
    this.t = t;
    this.isBlocked = false;
    this.unblock = () => {};
    this.mute = node("button", { class: "mute" });
    this.mute.addEventListener("click", () => this.toggle());
    const range = { type: "range", min: "0", max: "1", step: "0.05", "aria-label": t("Volume") };
    this.volume = node("input", { class: "volume slider", ...range });
    this.volume.addEventListener("input", () => {
      element.volume = this.volume.valueAsNumber;
      element.muted = false;
      this.unblock();
    });
    // These keys move the volume's thumb; the player must not also seek.
    this.volume.addEventListener("keydown", (event) => {
      if (/^(Arrow|Home|End|Page)/.test(event.key)) event.stopPropagation();
    });
    this.unmute = node(
      "button",
      { class: "unmute", hidden: true },
      drawn(ICONS.silent),
      t("Unmute"),
    );
    this.unmute.addEventListener("click", () => this.toggle());
  }

  /** Whether nothing can be heard, for whatever reason. */
  get isSilent() {
    return this.element.muted || this.element.volume === 0 || this.isBlocked;
  }

  toggle() {
    const { element } = this;
    if (!this.isSilent) {
      element.muted = true;
      return;
    }
    if (element.volume === 0) element.volume = 1;
    element.muted = false;
    this.unblock();
  }

  /** @param {boolean} isThere whether there is sound to control */
  show(isThere) {
    const { mute, volume, unmute, element, isSilent, t } = this;
    mute.hidden = volume.hidden = !isThere;
    unmute.hidden = !isThere || !this.isBlocked;
    const label = isSilent ? t("Unmute") : t("Mute");
    const heard = element.muted ? 0 : element.volume;
    volume.value = String(heard);
    const end = `${100 * heard}%`;
    const track = `linear-gradient(to right, var(--played) ${end}, var(--rest) ${end})`;
    volume.style.setProperty("--track", track);
    if (mute.getAttribute("aria-label") === label) return;
    mute.replaceChildren(drawn(isSilent ? ICONS.silent : ICONS.heard));
    mute.setAttribute("aria-label", label);
    mute.title = `${label} (M)`;
  }
}
