import {
  ContextLostError,
  makeFramebuffer,
  makeProgram,
  makeTexture,
  RendererError,
  STAGED_WIDTH_PX,
} from "./program.js";
import EXPAND from "./shaders/expand.glsl";

import { floatWords, latticeWords } from "../playback/words.js";

/** Staging textures in rotation, so that none is written while an earlier upload may still be read. */
const NUM_STAGED = 3;

/** Texels of a drawn Gaussian, as in pack.py. @param {number} shDegree */
function texelsPerGaussian(shDegree) {
  return Math.ceil((15 + 3 * ((shDegree + 1) ** 2 - 1)) / 4);
}

/**
 * All slots as texels that the splat shader reads. Changed Gaussians are uploaded quantised, as they were
 * received, and a GPU pass expands them.
 */
export class Resident {
  nextStaged = 0;
  /** @type {import("./colourpass.js").ColourPass | null} evaluates the colours of changed Gaussians */
  colours = null;
  /** @type {import("./smoothing.js").Inbetween | null} saves Gaussians that are about to change */
  inbetween = null;
  uploadedBytes = 0;

  /** @param {WebGL2RenderingContext} gl @param {number} numSlots @param {number} shDegree */
  constructor(gl, numSlots, shDegree) {
    this.gl = gl;
    this.shDegree = shDegree;
    this.texels = texelsPerGaussian(shDegree);
    this.columns = Math.floor(2048 / this.texels);
    this.widthPx = this.columns * this.texels;
    this.heightPx = Math.max(1, Math.ceil(numSlots / this.columns));
    const limitPx = Number(gl.getParameter(gl.MAX_TEXTURE_SIZE));
    if (gl.isContextLost()) throw new ContextLostError(); // the limit would be null
    if (Math.max(this.heightPx, this.widthPx) > limitPx) {
      throw new RendererError(
        `${numSlots} Gaussians need a texture of ${this.widthPx}x${this.heightPx}; this device allows ${limitPx}`,
      );
    }
    this.texture = makeTexture(gl);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32UI, this.widthPx, this.heightPx);
    this.framebuffer = makeFramebuffer(gl, this.texture);
    this.staged = Array.from({ length: NUM_STAGED }, () => ({ texture: makeTexture(gl), rows: 0 }));
    /** Has no attributes: the shaders use only the number of each point. */
    this.points = gl.createVertexArray();
    const defines = {
      COLUMNS: this.columns,
      TEXELS: this.texels,
      STAGED_WIDTH_PX,
      K: (shDegree + 1) ** 2,
    };
    this.lattice = makeProgram(gl, EXPAND, {
      ...defines,
      LATTICE: 1,
      ITEM_WORDS: latticeWords(shDegree),
    });
    this.floats = makeProgram(gl, EXPAND, {
      ...defines,
      ITEM_WORDS: floatWords(shDegree),
    });
  }

  /**
   * Waits for the programs. Throws a RendererError if one was refused.
   * @param {import("../format/gaussians.js").Lattice[]} lattices of each layer
   */
  start(lattices) {
    const { gl } = this;
    for (const { check } of [this.lattice, this.floats]) check();
    gl.useProgram(this.lattice.program);
    for (const [layer, steps] of lattices.entries()) {
      const { positionM, logScale, logScaleBase, rotation, colour, opacityLevels } = steps;
      gl.uniform4f(this.lattice.at(`steps[${layer}]`), positionM, logScale, logScaleBase, rotation);
      gl.uniform2f(this.lattice.at(`more_steps[${layer}]`), colour, opacityLevels - 1);
    }
  }

  /** Puts Gaussians into their slots. @param {Uint32Array} words `latticeWords` each, in `roomFor` them */
  putLattice(words) {
    this.#put(words, latticeWords(this.shDegree), this.lattice, 3);
  }

  /**
   * Puts Gaussians into their slots.
   * @param {Uint32Array} words the bits of `floatWords` floats each, in `roomFor` them
   */
  putFloats(words) {
    this.#put(words, floatWords(this.shDegree), this.floats, 0);
  }

  /**
   * @param {Uint32Array} words @param {number} wordsEach @param {import("./program.js").Program} program
   * @param {number} slotWord index of the word with a Gaussian's slot
   */
  #put(words, wordsEach, program, slotWord) {
    if (words.length === 0) return;
    const { gl } = this;
    const staged = this.stage(words);
    const count = Math.floor(words.length / wordsEach);
    const saved = this.inbetween?.setAside(staged, count, wordsEach, slotWord);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    gl.viewport(0, 0, this.widthPx, this.heightPx);
    gl.disable(gl.BLEND);
    gl.useProgram(program.program);
    gl.uniform1i(program.at("staged"), 0);
    gl.uniform2f(program.at("size_px"), this.widthPx, this.heightPx);
    if (saved) gl.uniform2ui(program.at("saved"), ...saved);
    gl.bindVertexArray(this.points);
    gl.drawArrays(gl.POINTS, 0, count * this.texels);
    this.colours?.put(this.texture, staged, count, wordsEach, slotWord);
  }

  /** Uploads `words` into the next staging texture; binds and returns it. @param {Uint32Array} words */
  stage(words) {
    const { gl } = this;
    const staged = this.staged[this.nextStaged];
    this.nextStaged = (this.nextStaged + 1) % NUM_STAGED;
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, staged.texture);
    const rowWords = 4 * STAGED_WIDTH_PX;
    const rows = Math.ceil(words.length / rowWords);
    const [format, type] = [gl.RGBA_INTEGER, gl.UNSIGNED_INT];
    if (rows > staged.rows) {
      staged.rows = Math.ceil(1.25 * rows);
      gl.texImage2D(
        gl.TEXTURE_2D,
        0,
        gl.RGBA32UI,
        STAGED_WIDTH_PX,
        staged.rows,
        0,
        format,
        type,
        null,
      );
    }
    const whole = Math.floor(words.length / rowWords);
    if (whole > 0) {
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, STAGED_WIDTH_PX, whole, format, type, words);
    }
    const rest = words.subarray(whole * rowWords);
    if (rest.length > 0) {
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, whole, rest.length / 4, 1, format, type, rest);
    }
    this.uploadedBytes += words.byteLength;
    return staged.texture;
  }

  close() {
    const { gl } = this;
    gl.deleteTexture(this.texture);
    gl.deleteFramebuffer(this.framebuffer);
    gl.deleteVertexArray(this.points);
    for (const { texture } of this.staged) gl.deleteTexture(texture);
    for (const { program } of [this.lattice, this.floats]) gl.deleteProgram(program);
  }
}
