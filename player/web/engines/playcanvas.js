import {
  BoundingBox,
  Color,
  Entity,
  GSPLATDATA_LARGE,
  GSplatContainer,
  GSplatFormat,
  Mat4,
  PIXELFORMAT_RGBA32F,
  Quat,
  Vec3,
  WORKBUFFER_UPDATE_ALWAYS,
  WORKBUFFER_UPDATE_AUTO,
} from "playcanvas";

import { SceneVideo } from "./scenevideo.js";

/**
 * Settings of `app.scene.gsplat` that bring its picture closest to the renderer used in training: all
 * splats are drawn, however small, with unchanged positions and colours.
 */
export const RECIPE = {
  dataFormat: GSPLATDATA_LARGE,
  minPixelSize: 0,
  minContribution: 0,
  useTonemap: false,
};

/**
 * The engine uses changed splats only after its next sort, so all splats are copied for each picture
 * until nothing has changed for this time.
 */
const SETTLE_MS = 1000;

/** Names of the textures; each has four floats per slot. */
const STREAMS = ["place", "extent", "turn", "tint"];

const READ_GLSL = `
vec3 getCenter() { return loadPlace().xyz; }
vec4 getColor() { return vec4(loadTint().xyz, loadPlace().w); }
vec3 getScale() { return loadExtent().xyz; }
vec4 getRotation() { return loadTurn(); }
`;

const READ_WGSL = `
fn getCenter() -> vec3f { return loadPlace().xyz; }
fn getColor() -> vec4f { return vec4f(loadTint().xyz, loadPlace().w); }
fn getScale() -> vec3f { return loadExtent().xyz; }
fn getRotation() -> vec4f { return loadTurn(); }
`;

/**
 * A stream that plays by itself in a PlayCanvas scene, engine 2.23 or newer.
 *
 *     const entity = new SwingsEntity(app, { url: "https://streams.example.com/stream" });
 *     app.root.addChild(entity);
 *
 * The stream's world frame is kept, in metres; rotate and move the entity like any other. Colours lack
 * the view-dependent part, because the engine has no harmonics for splats that change.
 */
export class SwingsEntity extends Entity {
  /** @type {GSplatContainer | null} null until the stream is open */
  #container = null;
  #app;
  #changedMs = -Infinity;

  /**
   * @param {import("playcanvas").AppBase} app
   * @param {import("./scenevideo.js").SceneVideoOptions} options
   */
  constructor(app, options) {
    super("swings", app);
    this.#app = app;
    /** Playback control, see SceneVideo. */
    this.video = new SceneVideo(options);
    this.video.opened.then(
      (stream) => this.#show(stream),
      () => {},
    );
  }

  /** Seconds. */
  get currentTime() {
    return this.video.currentTime;
  }

  set currentTime(seconds) {
    this.video.currentTime = seconds;
  }

  play() {
    this.video.play();
  }

  pause() {
    this.video.pause();
  }

  /** An entity with a camera at the pose of the stream's default camera. */
  async defaultCamera() {
    const { position, axes, fovDeg, nearM } = await this.video.defaultCamera();
    const camera = new Entity("camera", this.#app);
    const lens = { fov: fovDeg, nearClip: nearM, farClip: 1000 };
    camera.addComponent("camera", { ...lens, clearColor: new Color(0, 0, 0) });
    const turn = new Mat4().set([
      ...[...axes.slice(0, 3), 0, ...axes.slice(3, 6), 0, ...axes.slice(6, 9), 0],
      ...[0, 0, 0, 1],
    ]);
    camera.setLocalPosition(...position);
    camera.setLocalRotation(new Quat().setFromMat4(turn));
    return camera;
  }

  /** Ends the play and frees its resources. */
  dispose() {
    this.destroy();
  }

  /** @override */
  destroy() {
    this.#app.off("update", this.#update, this);
    this.video.dispose();
    super.destroy();
    this.#container?.destroy();
    this.#container = null;
  }

  /** @param {import("./scenevideo.js").FeedStream} stream */
  #show({ numGs, bounds }) {
    const { graphicsDevice } = this.#app;
    const streams = STREAMS.map((name) => ({ name, format: PIXELFORMAT_RGBA32F }));
    const code = { readGLSL: READ_GLSL, readWGSL: READ_WGSL };
    const format = new GSplatFormat(graphicsDevice, streams, code);
    const container = new GSplatContainer(graphicsDevice, numGs, format);
    const [low, high] = bounds.map((corner) => new Vec3(corner));
    container.aabb = new BoundingBox();
    container.aabb.setMinMax(low, high);
    this.#container = container;
    this.addComponent("gsplat", { resource: container });
    this.#app.on("update", this.#update, this);
  }

  /** Writes the slots that have changed since the last picture; the engine then uploads all slots. */
  #update() {
    const container = this.#container;
    const slots = this.video.take();
    if (container === null || !this.gsplat) return;
    const nowMs = performance.now();
    if (slots !== null) this.#changedMs = nowMs;
    const isSettled = nowMs - this.#changedMs > SETTLE_MS;
    this.gsplat.workBufferUpdate = isSettled ? WORKBUFFER_UPDATE_AUTO : WORKBUFFER_UPDATE_ALWAYS;
    if (slots === null) return;
    const { means, scales, quats, opacities, colours } = this.video.gaussians;
    const textures = STREAMS.map((name) => container.getTexture(name));
    const [place, extent, turn, tint] = textures.map(
      (texture) => /** @type {Float32Array} */ (/** @type {unknown} */ (texture?.lock())),
    );
    const { centers } = container;
    for (const slot of slots) {
      const [at, from] = [4 * slot, 3 * slot];
      for (let axis = 0; axis < 3; axis++) {
        centers[from + axis] = means[from + axis];
        place[at + axis] = means[from + axis];
        extent[at + axis] = scales[from + axis];
        tint[at + axis] = colours[from + axis];
      }
      place[at + 3] = opacities[slot];
      // The engine reads w, x, y, z, although its documentation differs.
      turn.set(quats.subarray(at, at + 4), at);
    }
    for (const texture of textures) texture?.unlock();
    container.update();
  }
}
