import { node } from "./nodes.js";

/** Texts shown instead of messages that contain a URL or a status; the first matching pattern applies. */
const SENTENCES = /** @type {[RegExp, string][]} */ ([
  [/HTTP 40[13]\b/, "You have no access to this video."],
  [/HTTP (404|410)\b/, "This video does not exist, or is not here any more."],
  [/HTTP 5\d\d\b/, "The host of this video has a problem. Try again in a while."],
  [/does not let pages of other hosts/, "The host of this video does not let this page show it."],
  [
    /does not answer|cannot be reached/,
    "The host of this video cannot be reached. Check the network and try again.",
  ],
  [/damaged on the server/, "This video is damaged on its server."],
  [/https?:|file:/, "This video cannot be played."],
]);

const NO_WEBGL = /no WebGL2/;

/** Longer messages are replaced by a general sentence, and shown folded below it. */
const MOST_CHARS = 120;

/** @param {string} message */
export function sentenceOf(message) {
  const found = SENTENCES.find(([pattern]) => pattern.test(message));
  if (found) return found[1];
  if (message.length > MOST_CHARS) return "This video cannot be played.";
  return message.endsWith(".") ? message : `${message}.`;
}

/** The panel that shows why playback failed, with a button to try again and the folded details. */
export class Failure {
  /** Whether another try would not help: a browser without WebGL2 will not have it then. */
  isFinal = false;

  /**
   * @param {() => void} retry
   * @param {import("./texts.js").Translate} t
   */
  constructor(retry, t) {
    this.t = t;
    this.sentence = node("p", { class: "sentence" });
    this.retryButton = node("button", { class: "retry" }, t("Try again"));
    this.retryButton.addEventListener("click", retry);
    this.details = node("p", { class: "note" });
    this.fold = node("details", {}, node("summary", {}, t("Details")), this.details);
    const parts = [this.sentence, this.retryButton, this.fold];
    this.root = node("div", { class: "failure", role: "alert", hidden: true }, ...parts);
  }

  /** @param {string} message */
  show(message) {
    const sentence = sentenceOf(message);
    const isPlain = sentence === message || sentence === `${message}.`;
    this.sentence.textContent = isPlain
      ? sentence.replace(message, () => this.t(message))
      : this.t(sentence);
    this.details.textContent = message;
    this.isFinal = NO_WEBGL.test(message);
    this.retryButton.hidden = this.isFinal;
    this.root.classList.toggle("final", this.isFinal);
    this.fold.hidden = isPlain;
    this.fold.open = false;
    this.root.hidden = false;
  }

  clear() {
    this.isFinal = false;
    this.details.textContent = "";
    this.root.hidden = true;
  }
}
