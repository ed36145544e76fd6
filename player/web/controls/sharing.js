import { node } from "../element/nodes.js";

/** Permissions of an embedding frame: sound, full screen, headsets, copying, sharing, phone orientation. */
const ALLOW =
  "autoplay; fullscreen; xr-spatial-tracking; clipboard-write; web-share; gyroscope; accelerometer";

/** Links to the current time and view, and the code that embeds the player. */
export class Sharing {
  /**
   * @param {import("../element/swingsplayer.js").SwingsPlayerElement} element
   * @param {(message: string, forMs?: number) => void} hint shows a message
   */
  constructor(element, hint) {
    this.element = element;
    this.hint = hint;
  }

  /** The page that plays the stream. */
  #page() {
    const { element } = this;
    const link = element.getAttribute("link");
    if (link !== null) return new URL(link, document.baseURI);
    const url = new URL(pageUrl(), document.baseURI);
    url.searchParams.set("src", new URL(element.src, document.baseURI).href);
    return url;
  }

  /** A link that opens the page at the current time and view; null until a stream is open. */
  get link() {
    const { element } = this;
    if (!element.player?.manifest) return null;
    const url = this.#page();
    url.searchParams.set("t", element.currentTime.toFixed(2));
    url.searchParams.set("view", element.view);
    return url.href;
  }

  /** Opens the device's share dialog for the link; copies the link where there is none. */
  async share() {
    const url = this.link;
    if (url === null) return;
    if (navigator.share === undefined) return this.copyLink();
    const title = this.element.player?.manifest?.title || document.title;
    try {
      await navigator.share({ title, url });
    } catch (error) {
      // The user closed the dialog.
      if (error instanceof DOMException && error.name === "AbortError") return;
      await this.copyLink();
    }
  }

  async copyLink() {
    const url = this.link;
    if (url !== null) await this.#copy(url, "Link copied");
  }

  /** Copies the `<iframe>` of a page that shows the player. */
  async copyEmbedCode() {
    const url = this.#page();
    for (const name of ["t", "view"]) url.searchParams.delete(name);
    const source = url.href.replaceAll("&", "&amp;").replaceAll('"', "&quot;");
    const code =
      `<iframe src="${source}" width="720" height="405" style="border: 0" ` +
      `allow="${ALLOW}"></iframe>`;
    await this.#copy(code, "Embed code copied");
  }

  /** Saves the picture that shows, as the viewer sees it, without the controls. */
  savePicture() {
    const { player } = this.element;
    if (!player?.manifest || player.shownFrame < 0) return;
    const { shownFrame } = player;
    player.canvas.toBlob((file) => this.#save(file, shownFrame, "png"), "image/png");
  }

  /** Saves the Gaussians of the frame that shows, as the worker has them. */
  saveFrame() {
    const { player } = this.element;
    if (!player?.manifest || player.shownFrame < 0) return;
    const came = (/** @type {CustomEventInit<{ file: Blob, frame: number }>} */ { detail }) =>
      this.#save(detail?.file, detail?.frame ?? 0, "ply");
    player.addEventListener("ply", came, { once: true });
    player.requestPly();
  }

  /** @param {Blob | null | undefined} file @param {number} frame @param {string} suffix */
  #save(file, frame, suffix) {
    if (!file) return this.hint("This could not be saved");
    const title = this.element.player?.manifest?.title || "frame";
    const url = URL.createObjectURL(file);
    this.download(url, `${title.replace(/[^\p{L}\p{N}._-]+/gu, "-")}-${frame}.${suffix}`);
    URL.revokeObjectURL(url);
  }

  /**
   * Saves what is at `url`.
   * @param {string} url @param {string} [name] of the file; by default as its server, or the URL, has it
   */
  download(url, name = "") {
    node("a", { href: url, download: name }).click();
  }

  async openPictureInPicture() {
    try {
      await this.element.requestPictureInPicture();
    } catch (error) {
      console.warn("swings: no picture in picture:", error);
      this.hint("This browser does not open a picture in picture now");
    }
  }

  /** @param {string} text @param {string} done */
  async #copy(text, done) {
    try {
      await navigator.clipboard.writeText(text);
      this.hint(done);
    } catch (error) {
      console.info("swings: the browser does not let the page copy:", error);
      this.hint(text, 10_000); // the user can copy the shown text by hand
    }
  }
}

/** The page beside this code. */
function pageUrl() {
  const { href } = new URL("../watch.html", import.meta.url);
  // A server also has the bundle under a name that changes with its content; a link has to last.
  return href.replace(/\/bundle-[0-9a-f]{16}\//, "/bundle/");
}
