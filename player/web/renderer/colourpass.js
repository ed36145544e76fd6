import { COLOUR_COLUMNS, COLOUR_TURN_RAD, SH_C2, SH_C3 } from "../constants.js";
import COLOURS from "../../render/gl/shaders/colours.glsl";
import { makeFramebuffer, makeProgram, makeTexture, STAGED_WIDTH_PX } from "./program.js";

const HARMONICS = {
  ...Object.fromEntries(SH_C2.map((value, n) => [`SH_C2_${n}`, value])),
  ...Object.fromEntries(SH_C3.map((value, n) => [`SH_C3_${n}`, value])),
};

/**
 * The colour of each slot from harmonics of degree 2 or 3, in a texture for the splat shader.
 *
 * All colours are evaluated for one viewing position. They are evaluated again when the camera has moved
 * so far that the direction to a point at the near distance may have turned by COLOUR_TURN_RAD.
 */
export class ColourPass {
  /**
   * @param {WebGL2RenderingContext} gl @param {{ numSlots: number, nearM: number }} shape
   * @param {Record<string, number>} defines those of the splat shader
   */
  constructor(gl, { numSlots, nearM }, defines) {
    /** @type {WebGL2RenderingContext} */ this.gl = gl;
    /** @type {number} */ this.numSlots = numSlots;
    /** @type {number} */ this.reachM = COLOUR_TURN_RAD * nearM;
    /** @type {number} */ this.heightPx = Math.max(1, Math.ceil(numSlots / COLOUR_COLUMNS));
    /** @type {WebGLTexture} */ this.texture = makeTexture(gl);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32UI, COLOUR_COLUMNS, this.heightPx);
    /** @type {WebGLFramebuffer} */ this.framebuffer = makeFramebuffer(gl, this.texture);
    this.program = makeProgram(gl, COLOURS, { ...defines, ...HARMONICS, STAGED_WIDTH_PX });
    /** Has no attributes: the shader uses only the number of each point. @type {WebGLVertexArrayObject} */
    this.points = gl.createVertexArray();
    /** @type {number[] | null} the viewing position of all colours, metres */
    this.seenFrom = null;
  }

  /**
   * Evaluates all colours again if the camera has moved far enough.
   * @param {number[]} position of the camera in the world, metres @param {WebGLTexture} gaussians
   */
  follow(position, gaussians) {
    const { seenFrom } = this;
    if (seenFrom !== null) {
      const moved = Math.hypot(...position.map((value, axis) => value - seenFrom[axis]));
      if (moved <= this.reachM) return;
    }
    this.seenFrom = position;
    // The second sampler needs a texture of the right type, but does not read from it.
    this.#evaluate(position, gaussians, gaussians, this.numSlots, 0, 0);
  }

  /**
   * Evaluates the colours of Gaussians that were put into their slots.
   * @param {WebGLTexture} gaussians @param {WebGLTexture} staged the uploaded items @param {number} count
   * @param {number} itemWords words of each item @param {number} slotWord index of the word with the slot
   */
  put(gaussians, staged, count, itemWords, slotWord) {
    if (this.seenFrom === null) return; // all are evaluated before they are drawn
    this.#evaluate(this.seenFrom, gaussians, staged, count, itemWords, slotWord);
  }

  /**
   * @param {number[]} position @param {WebGLTexture} gaussians @param {WebGLTexture} staged
   * @param {number} count @param {number} itemWords @param {number} slotWord
   */
  #evaluate(position, gaussians, staged, count, itemWords, slotWord) {
    const { gl, program } = this;
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, staged);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, gaussians);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    gl.viewport(0, 0, COLOUR_COLUMNS, this.heightPx);
    gl.disable(gl.BLEND);
    gl.useProgram(program.program);
    gl.uniform1i(program.at("gaussians"), 0);
    gl.uniform1i(program.at("staged"), 1);
    gl.uniform1i(program.at("item_words"), itemWords);
    gl.uniform1i(program.at("slot_word"), slotWord);
    gl.uniform3fv(program.at("position"), position);
    gl.uniform2f(program.at("size_px"), COLOUR_COLUMNS, this.heightPx);
    gl.bindVertexArray(this.points);
    gl.drawArrays(gl.POINTS, 0, count);
  }

  close() {
    this.gl.deleteTexture(this.texture);
    this.gl.deleteFramebuffer(this.framebuffer);
    this.gl.deleteVertexArray(this.points);
    this.gl.deleteProgram(this.program.program);
  }
}
