/** Programs, textures and framebuffers of WebGL2, with the recipe's constants in front of a shader's text. */

import {
  ALPHA_MAX,
  ALPHA_MIN,
  COLOUR_COLUMNS,
  LOW_PASS_PX2,
  MAX_EXTENT_SIGMA,
  SH_C0,
  SH_C1,
} from "../constants.js";

/** The constants of the recipe by name. @returns {Record<string, number>} */
function recipe() {
  return {
    ALPHA_MAX,
    ALPHA_MIN,
    COLOUR_COLUMNS,
    LOW_PASS_PX2,
    MAX_EXTENT_SIGMA,
    SH_C0,
    SH_C1,
  };
}

// Marked as pure, so that the bundles of workers, which do not draw, omit it.
const RECIPE = /* @__PURE__ */ recipe();
// There are no storage buffers, so RESIDENT_BUFFER is not defined; and orders come from another thread.
const HEAD = `#version 300 es
#define STALE_ORDER
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp usampler2D;
`;

/** Index of the vertex attribute from which programs that draw Gaussians read their slots. */
export const SLOT = 0;

/** WebGL2 is not available, or cannot hold the stream. */
export class RendererError extends Error {
  name = "RendererError";
}

/** The context was lost before everything was made; try again once it is restored. */
export class ContextLostError extends RendererError {
  name = "ContextLostError";

  constructor() {
    super("The graphics device was lost");
  }
}

/**
 * A program, and the locations of its uniforms.
 * @typedef {object} Program
 * @property {WebGLProgram} program @property {(name: string) => WebGLUniformLocation | null} at
 * @property {() => void} check waits for the program; throws a RendererError if it was refused
 */

/**
 * Starts compiling a program. This may take the device some time; only `check` waits for it.
 * @param {WebGL2RenderingContext} gl @param {string} text both stages, in GLSL ES 3.00 without the version line
 * @param {Record<string, number>} defines @returns {Program}
 */
export function makeProgram(gl, text, defines = {}) {
  const constants = Object.entries({ ...RECIPE, ...defines });
  const lines = constants.map(([name, value]) => `#define ${name} ${value}\n`);
  const program = gl.createProgram();
  for (const [type, stage] of /** @type {[number, string][]} */ ([
    [gl.VERTEX_SHADER, "VERTEX_STAGE"],
    [gl.FRAGMENT_SHADER, "FRAGMENT_STAGE"],
  ])) {
    const shader = gl.createShader(type);
    if (shader === null) throw new ContextLostError();
    gl.shaderSource(shader, `${HEAD}${lines.join("")}#define ${stage}\n${text}`);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
    gl.deleteShader(shader);
  }
  gl.bindAttribLocation(program, SLOT, "slot");
  gl.linkProgram(program);
  /** @type {Map<string, WebGLUniformLocation | null>} */
  const places = new Map();
  const at = (/** @type {string} */ name) => {
    let place = places.get(name);
    if (place === undefined) {
      place = gl.getUniformLocation(program, name);
      places.set(name, place);
    }
    return place;
  };
  const check = () => {
    if (gl.getProgramParameter(program, gl.LINK_STATUS) || gl.isContextLost()) return;
    const logs = gl.getAttachedShaders(program)?.map((shader) => gl.getShaderInfoLog(shader)) ?? [];
    throw new RendererError(`a program is refused: ${[...logs, gl.getProgramInfoLog(program)]}`);
  };
  return { program, at, check };
}

/** Width of the textures in which Gaussians are uploaded. */
export const STAGED_WIDTH_PX = 1024;

/** A texture without filters, bound. @param {WebGL2RenderingContext} gl */
export function makeTexture(gl) {
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER])
    gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
  for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T])
    gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
  return texture;
}

/** A framebuffer that draws into a texture, bound. @param {WebGL2RenderingContext} gl @param {WebGLTexture} texture */
export function makeFramebuffer(gl, texture) {
  const framebuffer = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
  return framebuffer;
}
