const IDLE_MS = 2500;

/**
 * Shows and hides the bar. It shows during user activity, and always unless the stream plays. Moving the
 * mouse shows it; a tap on the picture shows or hides it.
 */
export class BarVisibility {
  #timer = 0;

  /**
   * @param {HTMLElement} frame gets the class `idle` while the bar is hidden
   * @param {HTMLElement} canvas
   * @param {() => boolean} plays
   * @param {() => boolean} isInUse whether a part of the bar is in use
   * @param {(isIdle: boolean) => void} changed called when the bar was hidden or shown
   */
  constructor(frame, canvas, plays, isInUse, changed) {
    this.changed = changed;
    this.frame = frame;
    this.canvas = canvas;
    this.plays = plays;
    this.isInUse = isInUse;
  }

  /**
   * @param {HTMLElement} element
   * @param {() => void} toggleFullScreen
   * @param {AbortSignal} signal ends the listening
   */
  listen(element, toggleFullScreen, signal) {
    const { canvas } = this;
    let lastPointer = "mouse";
    const onPointer = (/** @type {PointerEvent} */ event) => {
      lastPointer = event.pointerType;
      // A touch on the picture shows the bar only once it is known to be a tap: a bar that shows at once
      // would receive the tap.
      const isOnPicture = event.composedPath()[0] === canvas;
      if (event.pointerType !== "touch" || !isOnPicture) this.wake();
    };
    for (const type of /** @type {const} */ (["pointermove", "pointerdown"])) {
      element.addEventListener(type, onPointer, { signal });
    }
    const leave = (/** @type {PointerEvent} */ event) => {
      if (event.pointerType === "mouse") this.#rest();
    };
    element.addEventListener("pointerleave", leave, { signal });
    for (const type of ["keydown", "focusin", "play", "pause", "ended"]) {
      element.addEventListener(type, () => this.wake(), { signal });
    }
    const tap = () => {
      if (lastPointer === "touch") this.toggle();
    };
    canvas.addEventListener("click", tap, { signal });
    const double = (/** @type {MouseEvent} */ event) => {
      if (lastPointer === "mouse" && !event.altKey) toggleFullScreen();
    };
    canvas.addEventListener("dblclick", double, { signal });
    signal.addEventListener("abort", () => clearTimeout(this.#timer));
  }

  /** Shows the bar for some time. */
  wake() {
    this.#setIdle(false);
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.#rest(), IDLE_MS);
  }

  toggle() {
    if (this.frame.classList.contains("idle")) this.wake();
    else this.#rest();
  }

  #rest() {
    if (!this.plays()) return;
    if (this.isInUse()) this.wake();
    else this.#setIdle(true);
  }

  /** @param {boolean} isIdle */
  #setIdle(isIdle) {
    this.frame.classList.toggle("idle", isIdle);
    this.changed(isIdle);
  }
}
