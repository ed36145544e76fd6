import { ENTERS, MOVES } from "../constants.js";
import { floatWords, latticeWords } from "../playback/depthorder.js";
import { makeProgram, makeTexture, STAGED_WIDTH_PX } from "./program.js";
import IN_MOTION from "./shaders/moving.glsl";

/** A constant of KHR_parallel_shader_compile, which TypeScript does not know. */
const COMPLETION_STATUS_KHR = 0x91b1;

/**
 * Whether `check` would return without waiting; true if the browser cannot report it.
 * @param {WebGL2RenderingContext} gl @param {import("./program.js").Program} made @returns {boolean}
 */
function isMade(gl, { program }) {
  const canSay = gl.getExtension("KHR_parallel_shader_compile") !== null;
  return !canSay || gl.getProgramParameter(program, COMPLETION_STATUS_KHR);
}

/**
 * Draws Gaussians in motion from the previous frame: continuing Gaussians are mixed with their previous
 * state, new ones fade in, and replaced ones fade out (codec/slice.py). All of it happens in the vertex
 * stage: a picture between two frames uploads nothing.
 */
export class Inbetween {
  /** Progress of the motion to the newest frame, 0..1. */
  share = 1;
  /** The newest frame. */
  #frame = -1;
  /** Serial number of the update that is being uploaded. */
  #serial = 0;
  /** Serial number of the update that is in motion; 0: none. */
  #moving = 0;
  /** Number of Gaussians whose state was saved for the update. */
  #count = 0;
  #heightPx = 0;
  /** @type {WebGLTexture | null} */
  texture = null;

  /**
   * @param {import("./splatrenderer.js").SplatRenderer} renderer draws frames as they are until `attach`
   * @param {number} numSlots
   */
  constructor(renderer, numSlots) {
    const { gl, resident, defines } = renderer;
    /** @type {WebGL2RenderingContext} */ this.gl = gl;
    this.renderer = renderer;
    /** @type {number} */ this.texels = defines.SH_DEGREE >= 2 ? 4 : resident.texels;
    const more = { SAVED: this.texels, STAGED_WIDTH_PX, NUM_SLOTS: numSlots, ENTERS, MOVES };
    this.program = makeProgram(gl, IN_MOTION, { ...defines, ...more });
    this.splats = renderer.makeSplats({ ...more, MOVING: 1 }, IN_MOTION);
    /** @type {WebGLFramebuffer} */ this.framebuffer = gl.createFramebuffer();
  }

  /** Makes the renderer use it once its programs are ready. Throws a RendererError if one was refused. */
  attach() {
    const { gl, renderer, program, splats } = this;
    if (!isMade(gl, program) || !isMade(gl, splats)) return;
    program.check();
    splats.check();
    gl.deleteProgram(renderer.splats.program);
    renderer.splats = splats;
    renderer.inbetween = this;
    renderer.resident.inbetween = this;
  }

  /** Whether the picture depends on the share. */
  get isMoving() {
    return this.#moving !== 0;
  }

  /** Notes that `frame` shows from now on, even if it changes nothing. @param {number} frame */
  reach(frame) {
    if (frame !== this.#frame) this.#moving = 0;
    this.#frame = frame;
  }

  /** Prepares for the upload of an update. @param {import("../playback/depthorder.js").Words} update */
  begin({ frame, leaving, lattice, floats }) {
    this.#serial += 1;
    this.#count = 0;
    this.#moving = frame === this.#frame ? this.#serial : 0;
    if (this.#moving === 0) return;
    const { resident } = this.renderer;
    const { shDegree } = resident;
    const numItems = lattice.length / latticeWords(shDegree) + floats.length / floatWords(shDegree);
    if (!this.#reserve(leaving.length + numItems)) this.#moving = 0;
    else if (leaving.length > 0) this.setAside(resident.stage(leaving), leaving.length, 1, 0);
  }

  /** Makes room for `count` Gaussians; returns whether the device has it. @param {number} count */
  #reserve(count) {
    const { gl } = this;
    const { columns } = this.renderer.resident;
    const heightPx = Math.ceil(count / columns);
    if (heightPx <= this.#heightPx) return true;
    const limitPx = Number(gl.getParameter(gl.MAX_TEXTURE_SIZE));
    if (heightPx > limitPx) return false;
    this.#heightPx = Math.min(Math.ceil(1.25 * heightPx), limitPx);
    gl.deleteTexture(this.texture);
    this.texture = makeTexture(gl);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32UI, columns * this.texels, this.#heightPx);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.texture, 0);
    return true;
  }

  /**
   * Saves the state of slots that are about to change, if the update is in motion.
   * @param {WebGLTexture} staged items that name the slots, bound @param {number} count
   * @param {number} itemWords @param {number} slotWord index of the word with the slot
   * @returns {[number, number]} serial number of the update, place of the first item
   */
  setAside(staged, count, itemWords, slotWord) {
    const { gl, program, renderer } = this;
    const first = this.#count;
    if (this.#moving !== 0) {
      this.#count += count;
      const { resident, colours } = renderer;
      for (const [unit, texture] of [staged, resident.texture, colours?.texture].entries()) {
        gl.activeTexture(gl.TEXTURE0 + unit);
        gl.bindTexture(gl.TEXTURE_2D, texture ?? staged);
      }
      const widthPx = resident.columns * this.texels;
      gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
      gl.viewport(0, 0, widthPx, this.#heightPx);
      gl.disable(gl.BLEND);
      gl.useProgram(program.program);
      gl.uniform1i(program.at("gaussians"), 1);
      gl.uniform1i(program.at("colours"), 2);
      gl.uniform2f(program.at("size_px"), widthPx, this.#heightPx);
      gl.uniform3i(program.at("items"), itemWords, slotWord, first);
      gl.bindVertexArray(resident.points);
      gl.drawArrays(gl.POINTS, 0, count * this.texels);
      gl.activeTexture(gl.TEXTURE0);
    }
    return [this.#serial, first];
  }

  /** Sets the textures and uniforms of the program that draws the motion. */
  bind() {
    const { gl, texture } = this;
    const { splats, resident } = this.renderer;
    gl.activeTexture(gl.TEXTURE2);
    gl.bindTexture(gl.TEXTURE_2D, texture ?? resident.texture);
    gl.uniform1i(splats.at("before"), 2);
    gl.uniform1ui(splats.at("serial"), this.#moving);
    gl.uniform1f(splats.at("share"), this.#moving === 0 ? 1 : this.share);
  }

  close() {
    this.gl.deleteTexture(this.texture);
    this.gl.deleteFramebuffer(this.framebuffer);
    this.gl.deleteProgram(this.program.program);
  }
}

/** In-between pictures are drawn if the screen is this many times faster (player/playout/clock.py). */
const FASTER = 1.05;
/** The screen's rate is the median of this many intervals, and of at least LEAST_INTERVALS. */
const MOST_INTERVALS = 15;
const LEAST_INTERVALS = 5;
/** The rate is measured again after this time, because a busy page seems to have a slow screen. */
const AGAIN_MS = 3000;

/** @typedef {Omit<import("../playback/messages.js").Line, "line">} Line */

/**
 * Progress, 0 to 1, of the motion from the previous frame to the current one. The motion begins when the
 * frame is due, so the picture is up to one frame late.
 * @param {number} nowMs Unix time @param {Line} line @param {number} frame the current one
 * @param {number} fps @param {number} numFrames after which the stream may have looped
 */
export function shareAt(nowMs, { zeroMs, rate }, frame, fps, numFrames) {
  if (zeroMs === null) return 1;
  const frames = ((nowMs - zeroMs) / 1000) * fps * rate - frame;
  // The line may still be that of an earlier round of the loop.
  const way = frames - numFrames * Math.floor(frames / numFrames + 0.25);
  return Math.max(0, Math.min(1, way));
}

/** Makes a view show motion between frames during playback, on screens faster than the stream. */
export class Smoothing {
  /** Whether the next picture continues the motion. */
  isMoving = false;
  /** @type {number[]} milliseconds between pictures that were requested directly one after the other */
  #intervals = [];
  /** Whether the last picture requested the next one. */
  #isRequested = false;
  #lastMs = 0;
  #measuredMs = -Infinity;
  /** Milliseconds between two refreshes of the screen; while unknown, frames are drawn as they are. */
  #screenMs = Infinity;
  /** The frame of the last picture. */
  #frame = -1;
  /** @type {Inbetween | null} made for the last renderer */
  #inbetween = null;

  /** @param {import("../element/sceneview.js").SceneView} view */
  constructor(view) {
    this.view = view;
  }

  /**
   * Makes `renderer` draw between frames. Does not wait for the device, which may need a second to
   * compile the programs.
   * @param {import("./splatrenderer.js").SplatRenderer} renderer
   */
  attach(renderer) {
    if (renderer.inbetween !== null) return;
    try {
      const { manifest } = this.view;
      if (manifest === null) return;
      if (this.#inbetween?.renderer !== renderer)
        this.#inbetween = new Inbetween(renderer, manifest.numGs);
      this.#inbetween.attach();
    } catch (error) {
      if (renderer.gl.isContextLost()) return; // it gets another renderer
      console.warn("swings: this device draws no motion between frames:", error);
      this.view.smoothing = null;
    }
  }

  /**
   * Requests a redraw of this picture, and the next picture, if they continue the motion.
   * @param {number} nowMs time of the picture, on the page's clock
   * @returns {boolean} whether Gaussians that fade out may show
   */
  step(nowMs) {
    const { view } = this;
    const { session, manifest, painter, shownFrame, interpolates } = view;
    const { line, numFrames } = session;
    this.#measure(nowMs);
    const { renderer } = painter;
    this.isMoving = false;
    if (renderer === null || manifest === null || view.isEmpty) return false;
    this.attach(renderer);
    const { inbetween } = renderer;
    // Within a frame the share only grows: a pause shows all of the motion, and nothing jumps back after it.
    let share = shownFrame === this.#frame ? (inbetween?.share ?? 1) : 0;
    this.#frame = shownFrame;
    if (interpolates && line?.zeroMs != null) {
      this.isMoving = 1000 > FASTER * manifest.fps * line.rate * this.#screenMs;
      this.#isRequested = this.isMoving || this.#intervals.length < LEAST_INTERVALS;
      const nowFrom1970Ms = performance.timeOrigin + nowMs;
      const way = shareAt(nowFrom1970Ms, line, shownFrame, manifest.fps, numFrames);
      share = Math.max(share, way);
    }
    if (!this.isMoving) share = 1;
    if (inbetween && inbetween.share !== share) {
      inbetween.share = share;
      view.needsDrawing ||= inbetween.isMoving;
    }
    if (this.#isRequested && view.headset === null) view.loop.request();
    return this.isMoving;
  }

  /** Measures the screen's rate from consecutive pictures. @param {number} nowMs */
  #measure(nowMs) {
    if (this.#isRequested) {
      this.#intervals.push(nowMs - this.#lastMs);
      this.#measuredMs = nowMs;
    }
    this.#isRequested = false;
    this.#lastMs = nowMs;
    if (this.#intervals.length > MOST_INTERVALS) this.#intervals.shift();
    if (nowMs - this.#measuredMs > AGAIN_MS) this.#intervals = [];
    if (this.#intervals.length < LEAST_INTERVALS) return;
    const sorted = [...this.#intervals].sort((a, b) => a - b);
    this.#screenMs = sorted[sorted.length >> 1];
  }
}
