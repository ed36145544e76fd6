import SCREEN from "../../render/gl/shaders/screen.glsl";
import SPLAT from "../../render/gl/shaders/splat.glsl";
import { JACOBIAN_CLAMP } from "../constants.js";
import { floatWords, latticeWords } from "../playback/depthorder.js";
import {
  ContextLostError,
  makeFramebuffer,
  makeProgram,
  makeTexture,
  RendererError,
  SLOT,
  STAGED_WIDTH_PX,
} from "./program.js";
import EXPAND from "./shaders/expand.glsl";

/** Staging textures in rotation, so that none is written while an earlier upload may still be read. */
const NUM_STAGED = 3;

/** Texels of a drawn Gaussian, as in player/render/upload.py. @param {number} shDegree */
function texelsPerGaussian(shDegree) {
  return Math.ceil((15 + 3 * ((shDegree + 1) ** 2 - 1)) / 4);
}

/**
 * All slots as texels that the splat shader reads. Changed Gaussians are uploaded quantised, as they were
 * received, and a GPU pass expands them.
 */
class Resident {
  nextStaged = 0;
  /** @type {import("./colourpass.js").ColourPass | null} evaluates the colours of changed Gaussians */
  colours = null;
  /** @type {import("./smoothing.js").Inbetween | null} saves Gaussians that are about to change */
  inbetween = null;
  uploadedBytes = 0;

  /** @param {WebGL2RenderingContext} gl @param {number} numSlots @param {number} shDegree */
  constructor(gl, numSlots, shDegree) {
    /** @type {WebGL2RenderingContext} */ this.gl = gl;
    /** @type {number} */ this.shDegree = shDegree;
    /** @type {number} */ this.texels = texelsPerGaussian(shDegree);
    /** @type {number} */ this.columns = Math.floor(2048 / this.texels);
    /** @type {number} */ this.widthPx = this.columns * this.texels;
    /** @type {number} */ this.heightPx = Math.max(1, Math.ceil(numSlots / this.columns));
    const limitPx = Number(gl.getParameter(gl.MAX_TEXTURE_SIZE));
    if (gl.isContextLost()) throw new ContextLostError(); // the limit would be null
    if (Math.max(this.heightPx, this.widthPx) > limitPx) {
      throw new RendererError(
        `${numSlots} Gaussians need a texture of ${this.widthPx}x${this.heightPx}; this device allows ${limitPx}`,
      );
    }
    /** @type {WebGLTexture} */ this.texture = makeTexture(gl);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32UI, this.widthPx, this.heightPx);
    /** @type {WebGLFramebuffer} */ this.framebuffer = makeFramebuffer(gl, this.texture);
    this.staged = Array.from({ length: NUM_STAGED }, () => ({ texture: makeTexture(gl), rows: 0 }));
    /** Has no attributes: the shaders use only the number of each point. @type {WebGLVertexArrayObject} */
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
    if (whole > 0)
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, STAGED_WIDTH_PX, whole, format, type, words);
    const rest = words.subarray(whole * rowWords);
    if (rest.length > 0)
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, whole, rest.length / 4, 1, format, type, rest);
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

/**
 * The properties of a stream that the renderer depends on.
 * @typedef {object} Shape
 * @property {number} numSlots @property {number} shDegree
 * @property {typeof import("./colourpass.js").ColourPass | null} ColourPass its class, from degree 2 on
 * @property {number} nearM minimum depth; nothing nearer is drawn
 * @property {import("../format/gaussians.js").Lattice[]} lattices of each layer
 */

/** Draws a stream in recipe v1 with WebGL2. */
export class SplatRenderer {
  /** @type {import("./smoothing.js").Inbetween | null} draws between two frames */
  inbetween = null;
  numDrawn = 0;
  orderBytes = 0;
  /** @type {{ widthPx: number, heightPx: number, texture: WebGLTexture, framebuffer: WebGLFramebuffer } | null} */
  picture = null;
  /** @type {import("./depthquery.js").DepthQuery | null} made by its first use */
  depths = null;

  /** @param {WebGL2RenderingContext} gl @param {Shape} shape */
  constructor(gl, shape) {
    /** @type {WebGL2RenderingContext} */ this.gl = gl;
    /** @type {number} */ this.nearM = shape.nearM;
    /** @type {boolean} */ this.isFine = gl.getExtension("EXT_color_buffer_float") !== null;
    this.resident = new Resident(gl, shape.numSlots, shape.shDegree);
    const { columns, texels } = this.resident;
    const { shDegree } = shape;
    const defines = { COLUMNS: columns, TEXELS: texels, SH_DEGREE: shDegree };
    this.defines = defines;
    this.colours = shape.ColourPass && new shape.ColourPass(gl, shape, defines);
    this.resident.colours = this.colours;
    this.splats = this.makeSplats();
    this.screen = makeProgram(gl, SCREEN);
    /** @type {WebGLBuffer} */ this.order = gl.createBuffer();
    /** @type {WebGLVertexArrayObject} */ this.quads = gl.createVertexArray();
    gl.bindVertexArray(this.quads);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    gl.enableVertexAttribArray(SLOT);
    gl.vertexAttribDivisor(SLOT, 1);
    /** @type {WebGLVertexArrayObject} */ this.nothing = gl.createVertexArray();
    this.resident.start(shape.lattices);
    for (const { check } of [this.splats, this.screen]) check();
    this.colours?.program.check();
  }

  /**
   * A program that draws Gaussians.
   * @param {Record<string, number>} [defines] @param {string} [text] in front of the shader's
   */
  makeSplats(defines = {}, text = "") {
    return makeProgram(this.gl, text + SPLAT, { ...this.defines, ...defines });
  }

  /** Bytes of Gaussians and orders uploaded so far. */
  get uploadedBytes() {
    return this.resident.uploadedBytes + this.orderBytes;
  }

  /**
   * Uploads the changes and the new draw order, so that both take effect together.
   * @param {import("../playback/depthorder.js").Words[]} updates
   * @param {Uint16Array | Uint32Array} order slots, farthest first; numSlots and up: fading out
   * @param {number} frame
   */
  update(updates, order, frame) {
    const { gl, inbetween } = this;
    inbetween?.reach(frame);
    for (const update of updates) {
      inbetween?.begin(update);
      this.resident.putLattice(update.lattice);
      this.resident.putFloats(update.floats);
    }
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    // A new store, because the device may still read the previous frame from the old one.
    gl.bufferData(gl.ARRAY_BUFFER, order, gl.STREAM_DRAW);
    const type = order instanceof Uint16Array ? gl.UNSIGNED_SHORT : gl.UNSIGNED_INT;
    gl.bindVertexArray(this.quads);
    gl.vertexAttribIPointer(SLOT, 1, type, 0, 0);
    this.orderBytes += order.byteLength;
    this.numDrawn = order.length;
  }

  /**
   * Draws onto a part of the canvas.
   * @param {import("../format/manifest.js").Camera} camera as large as the part
   * @param {{ xPx: number, yPx: number }} corner lower left corner of the part
   * @param {WebGLFramebuffer | null} target null: the canvas
   */
  draw(camera, corner = { xPx: 0, yPx: 0 }, target = null) {
    const { gl } = this;
    this.colours?.follow(positionOf(camera), this.resident.texture);
    const picture = this.#pictureOf(camera.widthPx, camera.heightPx);
    gl.bindFramebuffer(gl.FRAMEBUFFER, picture.framebuffer);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    this.blend(camera, this.splats);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.viewport(corner.xPx, corner.yPx, camera.widthPx, camera.heightPx);
    gl.disable(gl.BLEND);
    gl.useProgram(this.screen.program);
    gl.uniform1i(this.screen.at("picture"), 0);
    gl.uniform2i(this.screen.at("corner_px"), corner.xPx, corner.yPx);
    gl.uniform3f(this.screen.at("background"), 0, 0, 0);
    gl.bindTexture(gl.TEXTURE_2D, picture.texture);
    gl.bindVertexArray(this.nothing);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  /**
   * Blends all Gaussians into the bound framebuffer.
   * @param {import("../format/manifest.js").Camera} camera @param {import("./program.js").Program} splats
   */
  blend(camera, splats) {
    const { gl } = this;
    gl.viewport(0, 0, camera.widthPx, camera.heightPx);
    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.useProgram(splats.program);
    this.#setCamera(camera, splats);
    if (splats === this.splats) this.inbetween?.bind();
    if (this.colours !== null) {
      gl.activeTexture(gl.TEXTURE1);
      gl.bindTexture(gl.TEXTURE_2D, this.colours.texture);
    }
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.resident.texture);
    gl.bindVertexArray(this.quads);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.numDrawn);
  }

  /** @param {import("../format/manifest.js").Camera} camera @param {import("./program.js").Program} splats */
  #setCamera(camera, splats) {
    const { gl } = this;
    const m = camera.w2c;
    const rotation = [m[0], m[4], m[8], m[1], m[5], m[9], m[2], m[6], m[10]]; // columns
    const [x, y, z] = [m[3], m[7], m[11]];
    gl.uniform1i(splats.at("gaussians"), 0);
    gl.uniform1i(splats.at("colours"), 1);
    gl.uniform1f(splats.at("near_m"), this.nearM);
    gl.uniformMatrix3fv(splats.at("rotation"), false, rotation);
    gl.uniform3f(splats.at("translation"), x, y, z);
    gl.uniform3fv(splats.at("position"), positionOf(camera));
    gl.uniform2f(splats.at("focal_px"), camera.fxPx, camera.fyPx);
    gl.uniform2f(splats.at("centre_px"), camera.cxPx, camera.cyPx);
    gl.uniform2f(splats.at("size_px"), camera.widthPx, camera.heightPx);
    gl.uniform2f(
      splats.at("limit"),
      (JACOBIAN_CLAMP * 0.5 * camera.widthPx) / camera.fxPx,
      (JACOBIAN_CLAMP * 0.5 * camera.heightPx) / camera.fyPx,
    );
  }

  /**
   * The target in which a picture is blended, row 0 at its top; in half floats if the device can.
   * @param {number} widthPx @param {number} heightPx
   */
  #pictureOf(widthPx, heightPx) {
    const { gl } = this;
    const old = this.picture;
    if (old !== null && old.widthPx === widthPx && old.heightPx === heightPx) return old;
    this.#dropPicture();
    const texture = makeTexture(gl);
    gl.texStorage2D(gl.TEXTURE_2D, 1, this.isFine ? gl.RGBA16F : gl.RGBA8, widthPx, heightPx);
    const framebuffer = makeFramebuffer(gl, texture);
    const status = gl.checkFramebufferStatus(gl.FRAMEBUFFER);
    if (status !== gl.FRAMEBUFFER_COMPLETE && !gl.isContextLost())
      throw new RendererError(`this device cannot draw a picture of ${widthPx}x${heightPx} pixels`);
    this.picture = { widthPx, heightPx, texture, framebuffer };
    return this.picture;
  }

  #dropPicture() {
    if (this.picture === null) return;
    this.gl.deleteTexture(this.picture.texture);
    this.gl.deleteFramebuffer(this.picture.framebuffer);
    this.picture = null;
  }

  close() {
    const { gl } = this;
    this.#dropPicture();
    this.depths?.close();
    this.colours?.close();
    this.inbetween?.close();
    this.resident.close();
    gl.deleteBuffer(this.order);
    for (const array of [this.quads, this.nothing]) gl.deleteVertexArray(array);
    for (const { program } of [this.splats, this.screen]) gl.deleteProgram(program);
  }
}

/** Position of the camera in the world, metres. @param {import("../format/manifest.js").Camera} camera */
function positionOf({ w2c: m }) {
  return [0, 1, 2].map((axis) => -(m[axis] * m[3] + m[4 + axis] * m[7] + m[8 + axis] * m[11]));
}
