import { ContextLostError } from "./program.js";
import { SharedContext } from "./sharedcontext.js";
import { SplatRenderer } from "./splatrenderer.js";

/**
 * Draws one stream onto one canvas, with the page's shared context. The canvas keeps its last picture
 * even if the context is lost.
 *
 * Events: `lost`, `restored` (an empty renderer waits for all Gaussians), `gone`; see SharedContext.
 */
export class Painter extends EventTarget {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    super();
    this.canvas = canvas;
    this.context = SharedContext.acquire();
    const target = canvas.getContext("2d", { alpha: false });
    if (target === null) throw new TypeError("the canvas has a context of another kind");
    this.target = target;
    /** @type {SplatRenderer | null} null while nothing is open or the context is lost */
    this.renderer = null;
    /** @type {import("./splatrenderer.js").Shape | null} */
    this.shape = null;
    this.listening = this.#listen();
  }

  #listen() {
    const listening = new AbortController();
    const { signal } = listening;
    this.context.addEventListener("lost", () => this.#lose(), { signal });
    this.context.addEventListener("restored", () => this.#restore(), { signal });
    this.context.addEventListener("gone", () => this.dispatchEvent(new Event("gone")), { signal });
    return listening;
  }

  /**
   * Makes an empty renderer, at once or as soon as the context is back. Throws a RendererError without
   * WebGL2, or if the device cannot hold the stream.
   * @param {import("./splatrenderer.js").Shape} shape
   */
  prepare(shape) {
    this.clear();
    this.shape = shape;
    if (this.context.isGone) {
      this.listening.abort();
      this.context.release();
      this.context = SharedContext.acquire();
      this.listening = this.#listen();
    }
    this.#makeRenderer(shape);
  }

  /** @param {import("./splatrenderer.js").Shape} shape */
  #makeRenderer(shape) {
    try {
      this.renderer = new SplatRenderer(this.context.gl, shape);
    } catch (error) {
      if (!(error instanceof ContextLostError)) throw error;
    }
  }

  #lose() {
    this.renderer = null; // its resources were lost with the context
    this.dispatchEvent(new Event("lost"));
  }

  #restore() {
    if (this.shape !== null) this.#makeRenderer(this.shape);
    this.dispatchEvent(new Event("restored"));
  }

  /**
   * Draws the renderer's Gaussians; the canvas gets the size of the picture. Does nothing while the
   * context is lost.
   * @param {import("../stereo/eyes.js").Viewpoint} viewpoint
   * @param {number} widthPx of the canvas
   * @param {number} heightPx
   */
  draw({ views, framebuffer }, widthPx, heightPx) {
    const { renderer, context } = this;
    if (renderer === null || context.isLost) return;
    if (framebuffer === null) context.fit(widthPx, heightPx);
    for (const { camera, corner } of views) renderer.draw(camera, corner, framebuffer);
    // If the context was lost meanwhile, its picture is black.
    if (framebuffer === null && !context.isLost) this.#present(widthPx, heightPx);
  }

  /**
   * Copies the lower left part of the shared canvas to the player's canvas.
   * @param {number} widthPx
   * @param {number} heightPx
   */
  #present(widthPx, heightPx) {
    const { canvas, target, context } = this;
    if (canvas.width !== widthPx) canvas.width = widthPx;
    if (canvas.height !== heightPx) canvas.height = heightPx;
    const top = context.canvas.height - heightPx;
    target.drawImage(context.canvas, 0, top, widthPx, heightPx, 0, 0, widthPx, heightPx);
  }

  /** Frees the stream's resources on the device; the canvas keeps its picture. */
  clear() {
    this.renderer?.close();
    this.renderer = null;
    this.shape = null;
  }

  dispose() {
    this.clear();
    this.listening.abort();
    this.context.release();
  }
}
