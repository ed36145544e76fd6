/** The eyes of a viewer as cameras: side by side, and of a headset. */
import assert from "node:assert/strict";
import { middleOf, sideBySide } from "../stereo/eyes.js";
import { pinholeOf, Placement, poseOfTransform } from "../stereo/headset.js";
import { inCamera, poseOf, worldToCamera } from "../view/pose.js";
import { add, cross, dot, length, subtract, times, unit } from "../view/vectors.js";
import { law, near, posed } from "./support.mjs";

/** A camera somewhere that looks somewhere. */
function someCamera(random) {
  const pose = posed(random.vector(), add(random.vector(), [9, 9, 9]), random.vector());
  const [widthPx, heightPx] = [320, 240];
  const lens = { fxPx: 300, fyPx: 310, cxPx: 170, cyPx: 111 };
  return { name: "c", widthPx, heightPx, ...lens, w2c: worldToCamera(pose) };
}

/** Place in the picture and depth of a world point. */
function project(camera, point) {
  const [x, y, z] = inCamera(camera.w2c, point);
  return [camera.fxPx * (x / z) + camera.cxPx, camera.fyPx * (y / z) + camera.cyPx, z];
}

law("eyes side by side see one row and one order, and points of the focus alike", 9, (random) => {
  const camera = someCamera(random);
  const [eyeDistanceM, focusM] = [0.07, 3];
  const { views, w2c } = sideBySide(camera, eyeDistanceM, focusM);
  assert.equal(String(views.map(({ corner }) => [corner.xPx, corner.yPx])), "0,0,320,0");
  const [left, right] = views.map((view) => view.camera);
  const pose = poseOf(camera);
  const between = subtract(poseOf(right).position, poseOf(left).position);
  near(between, times(pose.right, eyeDistanceM));
  near(worldToCamera(middleOf([left, right].map(poseOf))), camera.w2c);
  assert.equal(w2c, camera.w2c);
  for (const depthM of [focusM, 1, random.number(1, 20)]) {
    const seen = [random.number(-0.5, 0.5) * depthM, random.number(-0.4, 0.4) * depthM, depthM];
    const { right: x, down: y, forward: z, position } = pose;
    const point = [times(x, seen[0]), times(y, seen[1]), times(z, seen[2])].reduce(add, position);
    const [middle, inLeft, inRight] = [camera, left, right].map((one) => project(one, point));
    for (const eye of [inLeft, inRight]) near(eye.slice(1), middle.slice(1));
    near([inLeft[0] - inRight[0]], [300 * eyeDistanceM * (1 / depthM - 1 / focusM)]);
    near([(inLeft[0] + inRight[0]) / 2], [middle[0]]);
  }
});

/** The column-major matrix of WebXR of a pose: its axes are right, up and back. */
const transformOf = ({ right, down, forward, position }) => [
  ...[...right, 0, ...times(down, -1), 0, ...times(forward, -1), 0, ...position, 1],
];

const somePose = (random) => posed(random.vector(), random.vector(), random.vector());

law("an eye of a headset projects as OpenGL does", 20, (random) => {
  const [left, bottom] = [random.number(-2, -0.2), random.number(-2, -0.2)];
  const [right, top] = [random.number(0.2, 2), random.number(0.2, 2)];
  const projection = new Array(16).fill(0);
  [projection[0], projection[5]] = [2 / (right - left), 2 / (top - bottom)];
  [projection[8], projection[9]] = [
    (right + left) / (right - left),
    (top + bottom) / (top - bottom),
  ];
  const pose = poseOfTransform(transformOf(somePose(random)));
  const camera = { ...pinholeOf(projection, 1680, 1760), w2c: worldToCamera(pose) };
  for (let n = 0; n < 5; n++) {
    const [x, y, z] = [random.number(-3, 3), random.number(-3, 3), random.number(-9, -1)];
    const clip = [projection[0] * x + projection[8] * z, projection[5] * y + projection[9] * z];
    const wanted = [((1 + clip[0] / -z) / 2) * 1680, ((1 - clip[1] / -z) / 2) * 1760, -z];
    const away = [times(pose.right, x), times(pose.down, -y), times(pose.forward, -z)];
    near(project(camera, away.reduce(add, pose.position)), wanted, 1e-8);
  }
});

/** A pose that looks up by an angle from where it was. */
function tilted({ position, right, down, forward }, rad) {
  const [c, s] = [Math.cos(rad), Math.sin(rad)];
  const ahead = add(times(forward, c), times(down, -s));
  return { position, right, down: add(times(down, c), times(forward, s)), forward: ahead };
}

/** A pose of somebody who stands upright. */
function level(random, up) {
  const position = random.vector();
  return posed(position, add(position, cross(up, random.vector())), times(up, -1));
}

law("a viewer begins at the start, facing the same way but for the tilt of heads", 30, (random) => {
  const up = unit(random.vector());
  const [start, head] = [level(random, up), level(random, [0, 1, 0])];
  const tilt = () => random.choice([-Math.PI / 2, -1, 0, 0.7, Math.PI / 2]);
  const startTilt = random.choice([-Math.PI / 2, 0.4, Math.PI / 2]);
  const looking = tilted(head, tilt());
  const placement = new Placement(looking, tilted(start, startTilt), up);
  near(worldToCamera(placement.pose(head)), worldToCamera(start), 1e-9);
  near(placement.pose(looking).position, start.position, 1e-9);
});

law("where a headset counts from changes nothing, and a metre is a metre", 20, (random) => {
  const [start, head, eye] = [somePose(random), somePose(random), somePose(random)];
  const up = unit(random.vector());
  const found = new Placement(head, start, up).pose(eye);
  const [turn, shift] = [random.number(-3, 3), random.vector()];
  const [c, s] = [Math.cos(turn), Math.sin(turn)];
  const yawed = ([x, y, z]) => [c * x + s * z, y, c * z - s * x];
  const moved = ({ position, right, down, forward }) => ({
    position: add(yawed(position), shift),
    ...{ right: yawed(right), down: yawed(down), forward: yawed(forward) },
  });
  const again = new Placement(moved(head), start, up).pose(moved(eye));
  near(worldToCamera(again), worldToCamera(found), 1e-8);
  const wayM = length(subtract(found.position, start.position));
  near([wayM], [length(subtract(eye.position, head.position))]);
});

law("the middle of eyes that look outwards lies on the axis between them", 20, (random) => {
  const pose = somePose(random);
  const eyes = [-1, 1].map((side) => {
    const [c, s] = [Math.cos(0.09), side * Math.sin(0.09)];
    const forward = add(times(pose.forward, c), times(pose.right, s));
    const right = add(times(pose.right, c), times(pose.forward, -s));
    return { ...pose, position: add(pose.position, times(right, 0.03 * side)), right, forward };
  });
  const middle = middleOf(eyes);
  for (const axis of ["right", "down", "forward"]) near(middle[axis], pose[axis]);
  const off = subtract(middle.position, pose.position);
  near([dot(off, pose.right), dot(off, pose.down)], [0, 0]);
});
