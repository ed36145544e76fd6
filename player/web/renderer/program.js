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

/** Where programs that draw Gaussians take their slots from. */
export const SLOT = 0;

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
 * @property {() => void} check waits for the program; throws a RendererError if it was refused
 */

/** Of KHR_parallel_shader_compile, which TypeScript does not know. */
const COMPLETION_STATUS_KHR = 0x91b1;

/**
 * Has the device make a program, which may take it a while: the page does not wait before `check`.
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

/**
 * Whether `check` need not wait for a program; true where the browser cannot say.
 * @param {WebGL2RenderingContext} gl
 * @param {Program} made
 * @returns {boolean}
 */
export function isMade(gl, { program }) {
  const canSay = gl.getExtension("KHR_parallel_shader_compile") !== null;
  return !canSay || gl.getProgramParameter(program, COMPLETION_STATUS_KHR);
}
