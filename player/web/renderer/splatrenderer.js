import SCREEN from "../../render/gl/shaders/screen.glsl";
import SPLAT from "../../render/gl/shaders/splat.glsl";
import { JACOBIAN_CLAMP } from "../constants.js";
import { makeFramebuffer, makeProgram, makeTexture, RendererError, SLOT } from "./program.js";
import { Resident } from "./resident.js";

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
    this.gl = gl;
    this.nearM = shape.nearM;
    this.isFine = gl.getExtension("EXT_color_buffer_float") !== null;
    this.resident = new Resident(gl, shape.numSlots, shape.shDegree);
    const { columns, texels } = this.resident;
    const { shDegree } = shape;
    const defines = { COLUMNS: columns, TEXELS: texels, SH_DEGREE: shDegree };
    this.defines = defines;
    this.colours = shape.ColourPass && new shape.ColourPass(gl, shape, defines);
    this.resident.colours = this.colours;
    this.splats = this.makeSplats();
    this.screen = makeProgram(gl, SCREEN);
    this.order = gl.createBuffer();
    this.quads = gl.createVertexArray();
    gl.bindVertexArray(this.quads);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    gl.enableVertexAttribArray(SLOT);
    gl.vertexAttribDivisor(SLOT, 1);
    this.nothing = gl.createVertexArray();
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
    if (status !== gl.FRAMEBUFFER_COMPLETE && !gl.isContextLost()) {
      throw new RendererError(`this device cannot draw a picture of ${widthPx}x${heightPx} pixels`);
    }
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
