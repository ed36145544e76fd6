import { makeTexture } from "./texture.js";

/** A pixel that is less opaque than this has no depth. */
const LEAST_ALPHA = 0.25;

/** Draws the depths of Gaussians into one pixel, and reads it. */
export class DepthQuery {
  /**
   * @param {WebGL2RenderingContext} gl one that can draw into floats
   * @param {import("./program.js").Program} splats draws depths
   */
  constructor(gl, splats) {
    splats.check();
    this.gl = gl;
    this.splats = splats;
    this.texture = makeTexture(gl);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA16F, 1, 1);
    this.framebuffer = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.texture, 0);
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
