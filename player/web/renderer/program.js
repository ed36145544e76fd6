import {
  ALPHA_MAX,
  ALPHA_MIN,
  COLOUR_COLUMNS,
  LOW_PASS_PX2,
  MAX_EXTENT_SIGMA,
  SH_C0,
  SH_C1,
  SH_C2,
  SH_C3,
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
    ...Object.fromEntries(SH_C2.map((value, n) => [`SH_C2_${n}`, value])),
    ...Object.fromEntries(SH_C3.map((value, n) => [`SH_C3_${n}`, value])),
  };
}

// Workers, which draw nothing, go without.
const RECIPE = /* @__PURE__ */ recipe();
const HEAD = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp usampler2D;
`;

/** WebGL2 is not there, or cannot hold the stream. */
export class RendererError extends Error {
  /** @param {string} message */
  constructor(message) {
    super(message);
    this.name = "RendererError";
  }
}

/** The context was lost before everything was made; once it is restored it can be tried again. */
export class ContextLostError extends RendererError {
  constructor() {
    super("The graphics device was lost");
    this.name = "ContextLostError";
  }
}

/**
 * A program and where its uniforms are.
 * @typedef {object} Program
 * @property {WebGLProgram} program
 * @property {(name: string) => WebGLUniformLocation | null} at
 */

/**
 * @param {WebGL2RenderingContext} gl
 * @param {string} text both stages, in GLSL ES 3.00 but for the version
 * @param {Record<string, number>} defines
 * @returns {Program}
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
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
      throw new RendererError(`a shader does not compile: ${gl.getShaderInfoLog(shader)}`);
    }
    gl.deleteShader(shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
    throw new RendererError(`a program does not link: ${gl.getProgramInfoLog(program)}`);
  }
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
  return { program, at };
}
