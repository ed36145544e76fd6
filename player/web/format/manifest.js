/** manifest.json: the properties that must be known before the first slice (FORMAT.md, section 4). */

import {
  DEFAULT_MAX_GAUSSIANS,
  FLOAT_COPIES,
  MAX_BASE,
  MAX_CAMERAS,
  MAX_FPS,
  MAX_IMAGE_PX,
  MAX_LAYERS,
  MAX_MANIFEST_BYTES,
  MAX_NUM_GS,
  MAX_OPACITY_LEVELS,
  MAX_POSTER_BYTES,
  MAX_SEGMENT_FRAMES,
  MAX_SEGMENT_SLOTS,
  MAX_SH_DEGREE,
  MAX_SLOTS,
  MAX_STEP,
  MAX_SWIN_SIZE,
  MIN_FPS,
  MIN_STEP,
  VERSION,
} from "../constants.js";
import { corrupt, unsupported } from "./bytes.js";
import { SlotLayout } from "./gaussians.js";
import { boolean, field, integer, list, number, text } from "./json.js";

/**
 * A pinhole camera, OpenCV pose (x right, y down, z forward).
 * @typedef {object} Camera
 * @property {string} name @property {number} widthPx @property {number} heightPx @property {number} fxPx
 * @property {number} fyPx @property {number} cxPx @property {number} cyPx
 * @property {number[]} w2c (4, 4) world to camera, row by row, metres
 */

/** A camera of a manifest (FORMAT.md, section 4). Throws a FormatError. @param {unknown} value @returns {Camera} */
function readCamera(value) {
  const camera = {
    name: text(field(value, "name"), "camera name"),
    widthPx: integer(field(value, "width_px"), 1, MAX_IMAGE_PX, "width_px"),
    heightPx: integer(field(value, "height_px"), 1, MAX_IMAGE_PX, "height_px"),
    fxPx: number(field(value, "fx_px"), "fx_px"),
    fyPx: number(field(value, "fy_px"), "fy_px"),
    cxPx: number(field(value, "cx_px"), "cx_px"),
    cyPx: number(field(value, "cy_px"), "cy_px"),
    w2c: list(field(value, "w2c"), 16, 16, "w2c").map((entry) => number(entry, "w2c")),
  };
  if (camera.fxPx <= 0 || camera.fyPx <= 0)
    throw corrupt(`camera ${camera.name}: a focal length is not positive`);
  if (!isPose(camera.w2c))
    throw corrupt(`camera ${camera.name}: the pose is not a rotation and a translation`);
  return camera;
}

/** Whether a matrix is a rotation and a translation. @param {number[]} m (4, 4) */
function isPose(m) {
  const rows = [0, 4, 8].map((at) => m.slice(at, at + 3));
  const dot = (/** @type {number[]} */ a, /** @type {number[]} */ b) =>
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const isOrthonormal = rows.every((a, i) =>
    rows.every((b, j) => Math.abs(dot(a, b) - (i === j ? 1 : 0)) <= 1e-3),
  );
  const [a, b, c] = rows;
  const cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const lastRow = [0, 0, 0, 1];
  const isAffine = lastRow.every((expected, i) => Math.abs(m[12 + i] - expected) <= 1e-6);
  return isOrthonormal && dot(cross, c) >= 0 && isAffine;
}

const { fround } = Math;

/**
 * @typedef {object} Manifest
 * @property {number} version @property {number} fps @property {number} swinSize @property {number} numGs
 * @property {number} numLayers @property {number} segmentFrames @property {number} shDegree
 * @property {boolean} antialias
 * @property {number} nearM metres
 * @property {number[]} cameraNearM metres, at each camera; empty if it is `nearM` at all cameras
 * @property {number[][]} bounds lower and upper corner, metres
 * @property {Camera[]} cameras
 * @property {Camera} defaultCamera what a player starts from
 * @property {number[] | null} focus the middle of what moves, metres
 * @property {boolean} live @property {string | null} poster @property {string | null} storyboard
 * @property {string} objectUrl @property {string} title @property {number} captureFrame
 * @property {SlotLayout} layout
 * @property {unknown} sound sources, not checked yet
 * @property {unknown} captions not checked yet
 * @property {string[]} parts names of the objects of each segment, in the order of the index
 */

/** A part of a segment, by its number in `Manifest.parts`: the changes of layer n are n. @typedef {number} Part */

/** The skip maps. @param {{ numLayers: number }} manifest @returns {Part} */
export const skipMapsOf = ({ numLayers }) => numLayers;

/** The keyframe of a layer. @param {{ numLayers: number }} manifest @param {number} layer @returns {Part} */
export const keyframeOf = ({ numLayers }, layer) => numLayers + 1 + layer;

/** @param {{ numLayers: number }} manifest @param {Part} part */
export const isKeyframe = ({ numLayers }, part) => part > numLayers;

/** The layer of a part; 0 for the skip maps. @param {{ numLayers: number }} manifest @param {Part} part */
export const layerOf = ({ numLayers }, part) =>
  part < numLayers ? part : Math.max(0, part - numLayers - 1);

/** Maximum size of the chunk in a packet of a part. @param {Manifest} manifest @param {Part} part */
export function limitBytes({ layout }, part) {
  if (part === skipMapsOf(layout)) return layout.maxSkipMapBytes;
  const layer = layerOf(layout, part);
  return isKeyframe(layout, part) ? layout.maxKeyframeBytes(layer) : layout.maxChangeBytes(layer);
}

/** Reads the manifest in `bytes`. Throws a FormatError. @param {Uint8Array} bytes @returns {Manifest} */
export function readManifest(bytes) {
  if (bytes.length > MAX_MANIFEST_BYTES)
    throw corrupt(`manifest: ${bytes.length} bytes, but at most ${MAX_MANIFEST_BYTES} are allowed`);
  const value = parsed(bytes);
  const version = field(value, "version");
  if (!Number.isInteger(version)) throw corrupt("manifest: this is not a swings stream");
  if (version !== VERSION)
    throw unsupported(`manifest: version ${version}, not ${VERSION}; the stream must be made anew`);
  const swinSize = integer(field(value, "swin_size"), 1, MAX_SWIN_SIZE, "swin_size");
  const numGs = integer(field(value, "num_gs"), 1, MAX_NUM_GS, "num_gs");
  if (numGs % swinSize !== 0 || numGs / swinSize > MAX_SLOTS)
    throw corrupt(`manifest: num_gs ${numGs} does not fit swin_size ${swinSize}`);
  const segmentFrames = integer(
    field(value, "segment_frames"),
    1,
    MAX_SEGMENT_FRAMES,
    "segment_frames",
  );
  const shDegree = integer(field(value, "sh_degree"), 0, MAX_SH_DEGREE, "sh_degree");
  const layout = readLayout(value, swinSize, segmentFrames, shDegree, numGs);
  const { numLayers } = layout;
  const cameras = list(field(value, "cameras"), 1, MAX_CAMERAS, "cameras").map(readCamera);
  if (new Set(cameras.map((camera) => camera.name)).size !== cameras.length)
    throw corrupt("manifest: two cameras have the same name");
  const name = text(field(value, "default_camera"), "default_camera");
  const defaultCamera = cameras.find((camera) => camera.name === name);
  if (defaultCamera === undefined)
    throw corrupt(`manifest: no camera is named ${name.slice(0, 80)}`);
  const { view, focus } = /** @type {Record<string, unknown>} */ (value);
  return {
    version,
    fps: readFps(value),
    swinSize,
    numGs,
    numLayers,
    segmentFrames,
    shDegree,
    antialias: boolean(field(value, "antialias"), "antialias"),
    nearM: positive(number(field(value, "near_m"), "near_m"), "near_m"),
    cameraNearM: readCameraNearM(value, cameras.length),
    bounds: readBounds(value),
    cameras,
    defaultCamera: view === undefined ? defaultCamera : readCamera(view),
    focus: focus === undefined ? null : readPoint(focus, "focus"),
    live: boolean(field(value, "live"), "live"),
    poster: readPicture(field(value, "poster"), "poster"),
    storyboard: readStoryboard(value),
    objectUrl: readObjectUrl(value),
    title: text(field(value, "title"), "title"),
    captureFrame: integer(field(value, "capture_frame"), 0, 2 ** 31 - 1, "capture_frame"),
    layout,
    sound: /** @type {Record<string, unknown>} */ (value).sound,
    captions: /** @type {Record<string, unknown>} */ (value).captions,
    parts: partsOf(numLayers),
  };
}

/**
 * Throws a FormatError if a stream has more Gaussians than a page should hold: a stream of a few
 * kilobytes may declare 2^24. To be called before anything is decoded or allocated.
 * @param {Manifest} manifest @param {number | null} maxGaussians null for the default @param {string} name
 */
export function checkGaussians({ numGs, shDegree }, maxGaussians, name) {
  if (numGs <= (maxGaussians ?? DEFAULT_MAX_GAUSSIANS)) return;
  const floats = 11 + 3 * (shDegree + 1) ** 2;
  const memoryGb = ((FLOAT_COPIES * 4 * floats * numGs) / 1e9).toFixed(1);
  throw unsupported(
    `${name} has ${numGs.toLocaleString("en")} Gaussians; max-gaussians=${numGs}, as an attribute of ` +
      `the player or in the address of its page, allows it (about ${memoryGb} GB of memory)`,
  );
}

/** @param {Uint8Array} bytes @returns {unknown} */
function parsed(bytes) {
  try {
    return JSON.parse(new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(bytes));
  } catch (error) {
    throw corrupt(`manifest: is not JSON: ${/** @type {Error} */ (error).message}`);
  }
}

/** @param {number} numLayers */
function partsOf(numLayers) {
  const layers = [...Array(numLayers).keys()];
  return [...layers.map(String), "skipmaps", ...layers.map((layer) => `keyframe-${layer}`)];
}

/**
 * @param {unknown} value @param {number} swinSize @param {number} segmentFrames @param {number} shDegree
 * @param {number} numGs
 */
function readLayout(value, swinSize, segmentFrames, shDegree, numGs) {
  const counts = list(field(value, "slots"), 1, MAX_LAYERS, "slots");
  const slots = counts.map((count) => integer(count, 1, MAX_SLOTS, "slots"));
  const rows = list(field(value, "lattice"), slots.length, slots.length, "lattice");
  const layout = new SlotLayout(swinSize, segmentFrames, shDegree, slots, rows.map(readLattice));
  if (layout.numSlots * swinSize !== numGs || segmentFrames * layout.numSlots > MAX_SEGMENT_SLOTS) {
    throw corrupt(
      `manifest: ${layout.numSlots} slots do not fit num_gs ${numGs} and segment_frames ${segmentFrames}`,
    );
  }
  return layout;
}

/** @param {unknown} row @returns {import("./gaussians.js").Lattice} */
function readLattice(row) {
  const step = (/** @type {string} */ key) => {
    const found = number(field(row, key), key);
    if (found < MIN_STEP || found > MAX_STEP)
      throw corrupt(`manifest: ${key} of a lattice is ${found}, which is out of range`);
    return fround(found);
  };
  const base = number(field(row, "log_scale_base"), "log_scale_base");
  if (Math.abs(base) > MAX_BASE)
    throw corrupt(`manifest: log_scale_base is ${base}, which is out of range`);
  return {
    positionM: step("position_m"),
    logScale: step("log_scale"),
    logScaleBase: fround(base),
    rotation: step("rotation"),
    colour: step("colour"),
    opacityLevels: integer(field(row, "opacity_levels"), 2, MAX_OPACITY_LEVELS, "opacity_levels"),
  };
}

/** @param {unknown} value */
function readFps(value) {
  const fps = number(field(value, "fps"), "fps");
  if (!(fps >= MIN_FPS && fps <= MAX_FPS))
    throw corrupt(`manifest: fps is ${fps}, which is out of range`);
  return fps;
}

/** Checks that a number is above 0. @param {number} found @param {string} what */
function positive(found, what) {
  if (found <= 0) throw corrupt(`manifest: ${what} is ${found}, which is not positive`);
  return found;
}

/** @param {unknown} value @param {number} numCameras */
function readCameraNearM(value, numCameras) {
  const key = "camera_near_m";
  const { [key]: found = [] } = /** @type {Record<string, unknown>} */ (value);
  const least = list(found, 0, numCameras, key).length && numCameras;
  return list(found, least, numCameras, key).map((depth) => positive(number(depth, key), key));
}

/** @param {unknown} value @param {string} what */
const readPoint = (value, what) => list(value, 3, 3, what).map((x) => number(x, what));

/** @param {unknown} value */
function readBounds(value) {
  const corners = list(field(value, "bounds"), 2, 2, "bounds").map((corner) =>
    readPoint(corner, "a corner of bounds"),
  );
  if (corners[0].some((lower, axis) => lower > corners[1][axis]))
    throw corrupt("manifest: the lower corner of the bounds is above the upper one");
  return corners;
}

/** @param {unknown} value @param {string} what */
function readPicture(value, what) {
  if (value === null) return null;
  const path = text(value, what);
  const numBytes = new TextEncoder().encode(path).length;
  // eslint-disable-next-line no-control-regex -- these are what it looks for
  if (numBytes > MAX_POSTER_BYTES || /[\u0000-\u001f\u007f]/.test(path))
    throw corrupt(`manifest: ${what} is too long or contains a control character`);
  // A path that leads out of the stream's folder is ignored: `//` would begin another host.
  const leadsOut = path.split("/").some((part) => part === "" || part === "..");
  return leadsOut || !/[^/]\.(jpe?g|png|webp)$/i.test(path) ? null : path;
}

/** @param {unknown} value */
function readStoryboard(value) {
  const isThere = Object.hasOwn(/** @type {object} */ (value), "storyboard");
  return isThere ? readPicture(field(value, "storyboard"), "storyboard") : null;
}

/** @param {unknown} value */
function readObjectUrl(value) {
  const url = text(field(value, "object_url"), "object_url");
  const names = (url.match(/\{.*?\}/g) ?? []).sort();
  if (names.length !== 2 || names[0] !== "{layer}" || names[1] !== "{segment}")
    throw corrupt("manifest: object_url does not contain {segment} and {layer} once each");
  return url;
}
