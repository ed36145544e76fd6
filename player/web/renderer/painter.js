import { ContextLostError, RendererError } from "./program.js";
import { SplatRenderer } from "./splatrenderer.js";

/** A lost context that has not come back in this time, with the page in view, counts as gone. */
const RESTORE_LIMIT_MS = 10_000;

/** @type {SharedContext | null} */
let shared = null;

/**
 * The one WebGL2 context of a page, on a canvas that is in no document. All players draw with it, and
 * copy their pictures to their own canvases: browsers allow about 16 contexts per page, and a canvas
 * with a copy keeps its picture when the context is lost.
 *
 * Events: `lost`, `restored` (everything on the device must be made again), `gone` (it did not come back).
 */
class SharedContext extends EventTarget {
  /** The page's context, with the caller counted as a user. */
  static acquire() {
    shared ??= new SharedContext();
    shared.#numUsers += 1;
    return shared;
  }

  #numUsers = 0;
  #restoreTimer = 0;
  #listening = new AbortController();
  /** @type {WebGL2RenderingContext | null} */
  #gl = null;
  canvas = document.createElement("canvas");
  /** Whether the context was lost for good, so that users have to acquire another one. */
  isGone = false;

  constructor() {
    super();
    const { signal } = this.#listening;
    this.canvas.addEventListener("webglcontextlost", (event) => this.#lose(event), { signal });
    this.canvas.addEventListener("webglcontextrestored", () => this.#restore(), { signal });
  }

  /**
   * The context, created at its first use: that makes the page wait for the device, so it should come
   * after the start of the workers. Throws a RendererError if the browser has no WebGL2.
   */
  get gl() {
    const gl = (this.#gl ??= this.canvas.getContext("webgl2", {
      antialias: false,
      alpha: false,
      depth: false,
    }));
    if (gl === null)
      throw new RendererError("This browser has no WebGL2; use a current one or another device");
    return gl;
  }

  get isLost() {
    return this.#gl?.isContextLost() ?? false;
  }

  /**
   * Makes the canvas large enough for a picture. It shrinks only for a single user: with pictures of
   * several sizes, it would be reallocated for each of them.
   * @param {number} widthPx @param {number} heightPx
   */
  fit(widthPx, heightPx) {
    const { canvas } = this;
    const isShared = this.#numUsers > 1;
    const width = isShared ? Math.max(canvas.width, widthPx) : widthPx;
    const height = isShared ? Math.max(canvas.height, heightPx) : heightPx;
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
  }

  /** Removes a user; the last one returns the context to the browser. */
  release() {
    this.#numUsers -= 1;
    if (this.#numUsers > 0) return;
    this.#leave();
    this.#gl?.getExtension("WEBGL_lose_context")?.loseContext();
  }

  /** @param {Event} event */
  #lose(event) {
    event.preventDefault(); // otherwise the context never comes back
    if (!this.isLost) return;
    this.dispatchEvent(new Event("lost"));
    this.#limitWait();
  }

  #limitWait() {
    clearTimeout(this.#restoreTimer);
    this.#restoreTimer = setTimeout(() => {
      if (!document.hidden) {
        this.#leave();
        this.dispatchEvent(new Event("gone"));
        return;
      }
      // A page in the background may get no context until it is visible.
      const { signal } = this.#listening;
      const again = () => this.isLost && this.#limitWait();
      document.addEventListener("visibilitychange", again, { once: true, signal });
    }, RESTORE_LIMIT_MS);
  }

  #restore() {
    clearTimeout(this.#restoreTimer);
    this.dispatchEvent(new Event("restored"));
  }

  /** Stops being the page's context. */
  #leave() {
    clearTimeout(this.#restoreTimer);
    this.#listening.abort();
    this.isGone = true;
    if (shared === this) shared = null;
  }
}

/**
 * Draws one stream onto one canvas, with the page's shared context. The canvas keeps its last picture
 * even if the context is lost.
 *
 * Events: `lost`, `restored` (an empty renderer waits for all Gaussians), `gone`; see SharedContext.
 */
export class Painter extends EventTarget {
  context = SharedContext.acquire();
  /** @type {SplatRenderer | null} null while nothing is open or the context is lost */
  renderer = null;
  /** @type {import("./splatrenderer.js").Shape | null} */
  shape = null;

  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    super();
    /** @type {HTMLCanvasElement} */ this.canvas = canvas;
    const target = canvas.getContext("2d", { alpha: false });
    if (target === null) throw new TypeError("the canvas has a context of another kind");
    /** @type {CanvasRenderingContext2D} */ this.target = target;
    /** @type {AbortController} */ this.listening = this.#listen();
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
   * Draws the renderer's Gaussians; the canvas gets the size of the picture. Does nothing while the context is lost.
   * @param {import("../stereo/eyes.js").Viewpoint} viewpoint @param {number} widthPx of the canvas
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
   * @param {number} widthPx @param {number} heightPx
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
