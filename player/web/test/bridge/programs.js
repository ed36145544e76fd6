// Runs before the page's own scripts: keeps each WebGL program of the page and its two shaders.
const { linkProgram } = WebGL2RenderingContext.prototype;
const made = [];
WebGL2RenderingContext.prototype.linkProgram = function (program) {
  made.push({ gl: this, program, shaders: this.getAttachedShaders(program) });
  linkProgram.call(this, program);
};
WebGL2RenderingContext.prototype.deleteProgram = () => {};

window.numPrograms = () => made.length;

/** What is wrong with each program, and all that the compiler said of it; empty if nothing. */
window.complaintsOfPrograms = () =>
  made.map(({ gl, program, shaders }) => {
    const logs = shaders.map((shader) => gl.getShaderInfoLog(shader) ?? "");
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) logs.push("it is not linked");
    return logs.join("").replaceAll("\0", "").trim();
  });
