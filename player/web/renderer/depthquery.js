/** The depth of the scene at a pixel, for a viewer who flies there. */
import { makeFramebuffer, makeTexture } from "./program.js";

/** A pixel that is less opaque than this has no depth. */
const LEAST_ALPHA = 0.25;

/**
 * Depth of the scene at a pixel, metres; null if hardly anything shows there, or this device cannot
 * draw floats. Waits for the device.
 * @param {import("./splatrenderer.js").SplatRenderer} renderer
 * @param {import("../format/manifest.js").Camera} camera the one that the current order is for
 * @param {number} xPx from the left @param {number} yPx from the top
 */
export function depthAt(renderer, camera, xPx, yPx) {
  if (!renderer.isFine) return null;
  renderer.depths ??= new DepthQuery(renderer.gl, renderer.makeSplats({ DEPTH: 1 }));
  const { depths } = renderer;
  depths.begin();
  const cxPx = camera.cxPx - Math.floor(xPx);
  const cyPx = camera.cyPx - Math.floor(yPx);
  renderer.blend({ ...camera, cxPx, cyPx }, depths.splats);
  return depths.end();
}

/** Draws the depths of Gaussians into one pixel, and reads it. */
export class DepthQuery {
  /**
   * @param {WebGL2RenderingContext} gl one that can draw into floats
   * @param {import("./program.js").Program} splats draws depths
   */
  constructor(gl, splats) {
    splats.check();
    /** @type {WebGL2RenderingContext} */ this.gl = gl;
    this.splats = splats;
    /** @type {WebGLTexture} */ this.texture = makeTexture(gl);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA16F, 1, 1);
    /** @type {WebGLFramebuffer} */ this.framebuffer = makeFramebuffer(gl, this.texture);
  }

  /** Clears and binds the target: a single pixel, at the place of a picture's first pixel. */
  begin() {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
  }

  /** The mean depth, weighted as colours are, in metres; null if hardly anything shows. */
  end() {
    const { gl } = this;
    const pixel = new Float32Array(4);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.FLOAT, pixel);
    const [sum, , , alpha] = pixel;
    return alpha > LEAST_ALPHA ? sum / alpha : null;
  }

  close() {
    this.gl.deleteTexture(this.texture);
    this.gl.deleteFramebuffer(this.framebuffer);
    this.gl.deleteProgram(this.splats.program);
  }
}
