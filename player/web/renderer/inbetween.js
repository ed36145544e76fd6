import { ENTERS, MOVES } from "../constants.js";
import { isMade, makeProgram } from "./program.js";
import { floatWords, latticeWords } from "./resident.js";
import { makeTexture, STAGED_WIDTH_PX } from "./texture.js";

/** Text before the splat shader: mixes Gaussians changed by the newest update with their saved state. */
const MOVING = /* glsl */ `
#ifdef VERTEX_STAGE

uniform usampler2D before;  // SAVED texels for each Gaussian, COLUMNS of them in a row
uniform uint serial;        // of the newest update
uniform float share;        // progress of the motion, 0..1

int number = -1;            // index of this Gaussian's saved state; -1: none
float back = 0.0;           // weight of the saved state
float fade = 1.0;

void set_out(int slot, uvec2 came) {
  if (slot >= NUM_SLOTS) {
    number = slot - NUM_SLOTS;
    back = 1.0;
    fade = 1.0 - share;
  } else if (came.x == serial && share < 1.0) {
    int move = int(came.y) & 3;
    if (move == ENTERS) fade = share;
    if (move == MOVES) {
      number = int(came.y >> 2);
      back = 1.0 - share;
    }
  }
}

vec4 saved(int n) {
  ivec2 at = ivec2(number % COLUMNS * SAVED + n, number / COLUMNS);
  return uintBitsToFloat(texelFetch(before, at, 0));
}

vec4 on_its_way(vec4 there, int n) {
  if (number >= 0) there = back < 1.0 ? mix(there, saved(n), back) : saved(n);
  if (n == 0) there.w *= fade;
  return there;
}

vec3 colour_on_its_way(vec3 there) {
  if (number < 0) return there;
  vec3 was = vec3(saved(2).zw, saved(3).x);
  return back < 1.0 ? mix(there, was, back) : was;
}

#endif
`;

/**
 * Saves the state of some slots. With harmonics of degree 2 or more, the constant colour is replaced by
 * the colour as last seen.
 */
const SET_ASIDE = /* glsl */ `
#ifdef VERTEX_STAGE

uniform usampler2D staged;      // items that name the slots
uniform usampler2D gaussians;
uniform usampler2D colours;
uniform vec2 size_px;
uniform ivec3 items;            // words of each, index of the word with the slot, place of the first

flat out uvec4 texel;

void main() {
  int item = gl_VertexID / SAVED, n = gl_VertexID % SAVED;
  int word = item * items.x + items.y;
  uvec4 named = texelFetch(staged, ivec2(word / 4 % STAGED_WIDTH_PX, word / 4 / STAGED_WIDTH_PX), 0);
  int slot = int(named[word % 4] & 0xffffffu);
  texel = texelFetch(gaussians, ivec2(slot % COLUMNS * TEXELS + n, slot / COLUMNS), 0);
#if SH_DEGREE >= 2
  uvec4 seen = texelFetch(colours, ivec2(slot % COLOUR_COLUMNS, slot / COLOUR_COLUMNS), 0);
  if (n == 2) texel.zw = seen.xy;
  if (n == 3) texel.x = seen.z;
#endif
  int number = items.z + item;
  vec2 at = vec2(number % COLUMNS * SAVED + n, number / COLUMNS);
  gl_Position = vec4((at + 0.5) / size_px * 2.0 - 1.0, 0.0, 1.0);
  gl_PointSize = 1.0;
}

#else

flat in uvec4 texel;
out uvec4 stored;

void main() {
  stored = texel;
}

#endif
`;

/**
 * Draws Gaussians in motion from the previous frame: continuing Gaussians are mixed with their previous
 * state, new ones fade in, and replaced ones fade out (codec/halfway.py). All of it happens in the vertex
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

  /**
   * @param {import("./splatrenderer.js").SplatRenderer} renderer draws frames as they are until `attach`
   * @param {number} numSlots
   */
  constructor(renderer, numSlots) {
    const { gl, resident, defines } = renderer;
    this.gl = gl;
    this.renderer = renderer;
    this.texels = defines.SH_DEGREE >= 2 ? 4 : resident.texels;
    const more = { SAVED: this.texels, STAGED_WIDTH_PX, NUM_SLOTS: numSlots, ENTERS, MOVES };
    this.program = makeProgram(gl, SET_ASIDE, { ...defines, ...more });
    this.splats = renderer.makeSplats({ ...more, MOVING: 1 }, MOVING);
    this.framebuffer = gl.createFramebuffer();
    /** @type {WebGLTexture | null} */
    this.texture = null;
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

  /** Prepares for the upload of an update. @param {import("../playback/pendingupdates.js").Words} update */
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
    const limitPx = gl.getParameter(gl.MAX_TEXTURE_SIZE);
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
   * @param {WebGLTexture} staged items that name the slots, bound
   * @param {number} count
   * @param {number} itemWords
   * @param {number} slotWord index of the word with the slot
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
