import { ExtSplats, SplatMesh, utils } from "@sparkjsdev/spark";
import { Color, Matrix4, Object3D, PerspectiveCamera, Quaternion, Vector3 } from "three";

import { SceneVideo } from "./scenevideo.js";

/**
 * Options of a `SparkRenderer` that make it draw like the renderer used in training: classic splatting,
 * sorted by depth.
 */
export const RECIPE = {
  preBlurAmount: 0.3,
  blurAmount: 0,
  maxStdDev: 3.33,
  minAlpha: 1 / 255,
  sortRadial: false,
  accumExtSplats: true,
};

/** Splats per row of Spark's textures. */
const ROW_SPLATS = 2048;

/**
 * A stream that plays by itself in a three.js scene, drawn by Spark 2. The scene needs a `SparkRenderer`.
 *
 *     const mesh = new SwingsMesh({ url: "https://streams.example.com/stream" });
 *     scene.add(new SparkRenderer({ renderer, ...RECIPE }), mesh);
 *
 * The stream's world frame is kept, in metres; rotate and move the mesh like any other object.
 */
export class SwingsMesh extends Object3D {
  /** @param {import("./scenevideo.js").SceneVideoOptions} options */
  constructor(options) {
    super();
    /** Playback control, see SceneVideo. @type {SceneVideo} */
    this.video = new SceneVideo(options);
    /** @type {SplatMesh | null} null until the stream is open */
    this.splatMesh = null;
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

  /** A camera at the pose of the stream's default camera. @param {number} aspect width by height of the picture */
  async defaultCamera(aspect) {
    const { position, axes, fovDeg, nearM } = await this.video.defaultCamera();
    const camera = new PerspectiveCamera(fovDeg, aspect, nearM, 1000);
    const [x, y, z] = [0, 3, 6].map((at) => new Vector3().fromArray(axes, at));
    camera.position.set(...position);
    camera.quaternion.setFromRotationMatrix(new Matrix4().makeBasis(x, y, z));
    return camera;
  }

  /** Ends the play and frees its resources. */
  dispose() {
    this.video.dispose();
    this.splatMesh?.dispose();
    this.removeFromParent();
  }

  /** @param {import("./scenevideo.js").FeedStream} stream */
  #show({ numGs, shDegree }) {
    // One splat for each slot of the stream; slots that show nothing have zero opacity.
    const numWords = 4 * ROW_SPLATS * Math.ceil(numGs / ROW_SPLATS);
    const splats = new ExtSplats({
      extArrays: [new Uint32Array(numWords), new Uint32Array(numWords)],
      numSplats: numGs,
      extra: shDegree > 0 ? { sh1: new Uint32Array(numWords) } : {},
    });
    const harmonics = 3 * ((shDegree + 1) ** 2 - 1);
    const mesh = new SplatMesh({
      extSplats: splats,
      // Spark calls this before it reads the splats of a picture.
      onFrame: () => {
        const slots = this.video.take();
        if (slots === null) return;
        writeSplats(splats, this.video.gaussians, slots, harmonics);
        mesh.updateVersion();
      },
    });
    this.splatMesh = mesh;
    this.add(mesh);
  }
}

const [mean, scale] = [new Vector3(), new Vector3()];
const [quat, colour] = [new Quaternion(), new Color()];

/**
 * Writes the changed slots; Spark then uploads all slots.
 * @param {ExtSplats} splats @param {import("../feed/scene.js").SceneGaussians} gaussians
 * @param {Uint32Array} slots @param {number} each harmonics of a slot
 */
function writeSplats(splats, { means, scales, quats, opacities, colours, harmonics }, slots, each) {
  const { sh1, sh1Texture } = /** @type {{ sh1?: Uint32Array, sh1Texture?: any }} */ (splats.extra);
  for (const slot of slots) {
    mean.fromArray(means, 3 * slot);
    scale.fromArray(scales, 3 * slot);
    const [w, x, y, z] = quats.subarray(4 * slot, 4 * slot + 4);
    quat.set(x, y, z, w);
    // Spark expects display colours, without a conversion.
    [colour.r, colour.g, colour.b] = colours.subarray(3 * slot, 3 * slot + 3);
    splats.setSplat(slot, mean, scale, quat, opacities[slot], colour);
    if (sh1) utils.encodeExtSh1Rgb(sh1, slot, harmonics.subarray(each * slot, each * slot + 9));
  }
  for (const texture of [...splats.textures, sh1Texture?.value]) {
    if (texture) texture.needsUpdate = true;
  }
}
