import { source } from "./shaders.js";

/** WebGL2 is not there, or cannot hold the stream. */
export class RendererError extends Error {
  /** @param {string} message */
  constructor(message) {
    super(message);
    this.name = "RendererError";
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
 * @param {string} vertex
 * @param {string} fragment
 * @param {Record<string, number>} defines
 * @returns {Program}
 */
export function makeProgram(gl, vertex, fragment, defines = {}) {
  const program = gl.createProgram();
  for (const [type, body] of /** @type {[number, string][]} */ ([
    [gl.VERTEX_SHADER, vertex],
    [gl.FRAGMENT_SHADER, fragment],
  ])) {
    const shader = gl.createShader(type);
    if (shader === null)
      throw new RendererError("WebGL2 cannot create a shader: the context is lost");
    gl.shaderSource(shader, source(body, defines));
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
