/** The camera over time: bounds, inertia, flights, fly mode, links, turned phones. */
import assert from "node:assert/strict";
import { test } from "node:test";

import { boundsOf, excessOf } from "../view/bounds.js";
import { CameraMotion, distanceOf } from "../view/cameramotion.js";
import { cameraKeys, liftCameraKey } from "../controls/keys.js";
import { deviceTurn, turnBetween } from "../controls/cameracontrols.js";
import { between, Turntable } from "../view/flight.js";
import { poseOf, rigUp, worldToCamera } from "../view/pose.js";
import { add, cross, dot, length, subtract, times, turned } from "../view/vectors.js";
import { camera, law, manifestOf, near, posed, Random } from "./support.mjs";

/** The point at which the rings look. */
const SCENE = [0, 0, 4];
const RAD_PER_DEG = Math.PI / 180;

/** A scene filmed from these poses. */
function filmed(...poses) {
  const cameras = poses.map((pose, n) => camera({ name: `c${n}`, w2c: worldToCamera(pose) }));
  return manifestOf({ cameras });
}

/** Four cameras around the scene, at its height. */
const RING = [0, 1, 2, 3].map((n) => {
  const angle = (n * Math.PI) / 2;
  return posed([4 * Math.sin(angle), 0, 4 - 4 * Math.cos(angle)], SCENE);
});

function dome() {
  const random = new Random(1);
  return filmed(
    ...Array.from({ length: 40 }, () => {
      const [turn, tilt] = [random.number(0, 2 * Math.PI), random.number(0, 1.4)];
      const level = Math.cos(tilt);
      const way = [level * Math.sin(turn), -Math.sin(tilt), level * Math.cos(turn)];
      return posed(add(SCENE, times(way, 3)), SCENE);
    }),
  );
}

/** Cameras in a plane that look the same way. */
function wall() {
  const places = [-2, -1, 0, 1, 2].flatMap((x) => [-1, 0, 1].map((y) => [x / 4, y / 4, 0]));
  return filmed(...places.map((place) => posed(place, add(place, [0, 0, 1]))));
}

const ring = () => filmed(...RING);
const outward = () =>
  filmed(
    ...[0, 1, 2, 3, 4, 5].map((n) => posed(SCENE, add(SCENE, [Math.sin(n), 0.1 * n, Math.cos(n)]))),
  );
const model = () => filmed(posed([0, 0, -5], SCENE));
const onItsSide = () =>
  filmed(...RING.map((pose) => ({ ...pose, right: pose.down, down: times(pose.right, -1) })));
const RIGS = [ring, dome, wall, outward, model, onItsSide];

test("in a room one cannot go far behind the cameras", () => {
  const { cameras } = ring(); // 4 m from the middle
  const farthestM = (half) => {
    const bounds = [-half, half].map((x) => add(SCENE, [x, x, x]));
    return boundsOf({ cameras, bounds, defaultCamera: cameras[0] }).distanceM[1];
  };
  assert.deepEqual(
    [2, 5].map(farthestM).map((x) => x.toFixed(2)),
    ["6.00", "4.40"],
  );
});

/** A camera, and ways to move it through its keys and through pictures of its time. */
function moving(scene = ring(), isReduced = false) {
  const motion = new CameraMotion(scene, () => isReduced);
  const keys = cameraKeys({ motion, moved() {} });
  /** Shows pictures from one time to another, so many a second; returns the last one's answer. */
  const run = (fromMs, toMs, perS = 60) => {
    let answer = false;
    const count = Math.round(((toMs - fromMs) * perS) / 1000);
    for (let n = 1; n <= count; n++) answer = motion.step(fromMs + (n * 1000) / perS);
    return answer;
  };
  const lift = (key) => liftCameraKey({ motion, moved() {} }, key);
  return { motion, orbit: motion.orbit, keys, run, lift };
}

const size = ({ logDistance, pitchRad, headingRad, offM }) =>
  Math.hypot(logDistance, pitchRad, headingRad, ...offM);
/** How far a pose has turned about the vertical. */
const arc = ({ forward }) => Math.atan2(forward[0], forward[2]);

for (const made of RIGS) {
  test(`all cameras of a rig are within its bounds: ${made.name}`, () => {
    const scene = made();
    const bounds = boundsOf(scene);
    for (const pose of scene.cameras.map(poseOf)) {
      const distanceM = length(subtract(pose.position, bounds.centre));
      assert.ok(size(excessOf(bounds, pose, distanceM)) < 1e-9);
    }
    for (const [lower, upper] of [bounds.distanceM, bounds.pitchRad, bounds.heightM])
      assert.ok(lower < upper);
    assert.ok(bounds.focusM > 0);
  });

  // A link may have put the camera so far away that turns alone move it by kilometres.
  test(`what is beyond the bounds springs back with every picture: ${made.name}`, () => {
    for (const away of [
      (motion) => motion.approach(-60),
      (motion) => motion.approach(60),
      (motion) => motion.turn(2.5, -1.5),
      (motion) => motion.turn(-2.9, 1.5),
      (motion) => Array.from({ length: 9 }, () => motion.dragPan(900, -700, 500, 0)),
      (motion) => {
        motion.dragPan(500, 300, 200, 0);
        motion.turn(1, -2);
        motion.approach(-20);
      },
      (motion) => {
        motion.fly(true);
        motion.dragPan(900, 9000, 500, 0);
        motion.turn(0.4, 0.3);
      },
      (motion) => (motion.orbit.text = "1,2,30,-7,9"),
      (motion) => (motion.orbit.text = "900,-80,7,0.5,0.5,-0.5,0.5,20,1000,-3"),
    ]) {
      const { motion, orbit } = moving(made());
      motion.grab();
      away(motion);
      motion.release("turn", 1e6);
      let [answer, before] = [true, size(motion.excess)];
      const isFar = before >= 100;
      for (let n = 0; n < 250; n++) {
        answer = motion.step(16 * (n + 1));
        assert.ok(orbit.pose.position.every(Number.isFinite));
        const now = size(motion.excess);
        assert.ok(isFar || made === onItsSide || now - before < 1e-3);
        before = now;
      }
      assert.ok(before < 1e-3 && !answer, `${away}: ${before}`);
    }
  });
}

test("up is what a rig holds level", () => {
  const held = (...anglesDeg) => {
    const [yaw, pitch, roll] = anglesDeg.map((angle) => angle * RAD_PER_DEG);
    const turn = (axis) =>
      turned(turned(turned(axis, [0, 0, 1], roll), [1, 0, 0], pitch), [0, 1, 0], yaw);
    const [right, down, forward] = [turn([1, 0, 0]), turn([0, 1, 0]), turn([0, 0, 1])];
    return { position: [0, 0, 0], right, down, forward };
  };
  for (const [heldDeg, up] of [
    // tests/codec/test_camera.py has the same
    [
      [
        [0, -20, 1],
        [30, -25, -2],
        [65, -10, 0],
        [90, -30, 1],
      ],
      [-0.0069, -1, -0.0026],
    ],
    [
      [
        [0, -20, 0],
        [1, -20, 0],
      ],
      [0.003, -0.9397, 0.342],
    ],
    [
      [
        [0, 0, 90],
        [90, 0, 90],
        [180, 0, 90],
      ],
      [0, 0, -1],
    ],
  ])
    near(rigUp(heldDeg.map((angles) => held(...angles))), up, 1e-4);
  // A half ring that looks down, as most captures have it.
  const half = [0, 1, 2, 3, 4].map((n) => held(45 * n - 90, -25, 0));
  near(rigUp(half), [0, -1, 0], 1e-9);
  assert.ok(half.reduce((sum, { down }) => sum + down[2], 0) < -1, "their tops lean");
});

test("a rig of one side ends at its sides", () => {
  assert.equal(boundsOf(ring()).heading, null);
  assert.equal(boundsOf(model()).heading, null);
  near([boundsOf(wall()).heading?.halfRad ?? 0], [40 * RAD_PER_DEG]);
});

test("a drag that was let go runs out, the same at every rate of pictures", () => {
  const dragged = (restMs, isReduced = false) => {
    const found = moving(ring(), isReduced);
    found.motion.grab();
    for (let atMs = 0; atMs < 160; atMs += 16) found.motion.dragTurn(4, 0, atMs);
    found.motion.release("turn", 144 + restMs);
    return found;
  };
  const [slow, usual, fast] = [30, 60, 144].map((perS) => {
    const { motion, orbit, run } = dragged(0);
    const begin = arc(orbit.pose);
    assert.ok(motion.isMoving);
    run(144, 3144, perS);
    assert.ok(!motion.isMoving);
    return arc(orbit.pose) - begin;
  });
  // 4 pixels in 16 ms are 1.25 rad/s, and an e-folding of 0.25 s makes it 0.3125 rad.
  near([usual], [0.3125], 0.045);
  near([slow], [fast], 0.006);
  assert.ok(!dragged(300).motion.isMoving, "it rested before");
  assert.ok(!dragged(0, true).motion.isMoving, "a viewer wants less motion");
  const { motion, orbit, run } = dragged(0);
  const { pose } = orbit;
  motion.grab();
  run(200, 1200);
  assert.deepEqual(orbit.pose, pose, "it is held");
});

test("a drag beyond the bounds is harder", () => {
  const { motion } = moving();
  motion.grab();
  const pitches = Array.from({ length: 15 }, (_, n) => {
    if (n > 0) motion.turn(0, -0.1);
    return motion.excess.pitchRad;
  });
  const steps = pitches.slice(1).map((pitch, n) => Math.abs(pitch - pitches[n]));
  const beyond = steps.filter((step) => step > 1e-9).slice(1);
  assert.ok(beyond.length > 5 && beyond.every((step, n) => n === 0 || step < beyond[n - 1]));
  assert.ok(beyond[beyond.length - 1] < 0.03);
});

test("flights to the cameras of the rig, which any gesture ends", () => {
  const { motion, orbit, keys, run } = moving();
  motion.flyToCamera(1);
  assert.ok(motion.isMoving && motion.isInFlight);
  near(orbit.pose.position, [0, 0, 0]);
  run(0, 2000);
  assert.deepEqual([motion.isMoving, motion.isInFlight, motion.cameraIndex], [false, false, 1]);
  near(orbit.pose.position, RING[1].position);
  keys["["]();
  run(3000, 5000);
  assert.deepEqual([motion.cameraIndex, orbit.text], [0, "0,0,1,0,0"]);
  keys["["]();
  assert.equal(motion.cameraIndex, 3);
  const reduced = moving(ring(), true);
  reduced.keys["]"]();
  near(reduced.orbit.pose.position, RING[1].position);
  for (const gesture of [
    () => motion.grab(),
    () => motion.turn(0.1, 0),
    () => motion.approach(1),
    () => (orbit.text = "0,0,1,0,0"),
  ]) {
    motion.flyToCamera(1);
    run(0, 400);
    gesture();
    const { position } = orbit.pose;
    run(400, 2000);
    assert.ok(!motion.isMoving);
    near(orbit.pose.position, position);
  }
});

test("a flight along a ring keeps its distance, and turns without stops", () => {
  const { motion, orbit } = moving();
  motion.flyToCamera(1);
  let [whole, before] = [0, 0];
  for (let n = 0; n < 45; n++) {
    motion.step(20 * (n + 1));
    near([length(subtract(orbit.pose.position, SCENE))], [4], 1e-6);
    const turned = Math.abs(Math.sin(arc(orbit.pose) - before));
    before = arc(orbit.pose);
    assert.ok(turned < 0.1);
    whole += turned;
  }
  near([whole], [Math.PI / 2], 0.006);
});

law("the way between two poses turns evenly, and never jumps", 50, (random) => {
  const [from, to] = [0, 1].map(() => ({
    pose: posed(random.vector(), random.vector(), random.vector()),
    centre: random.vector(),
  }));
  const axes = ({ right, down, forward }) => [right, down, forward];
  const angle = (a, b) => {
    const trace = axes(a).reduce((sum, axis, n) => sum + dot(axis, axes(b)[n]), 0);
    return Math.acos(Math.max(-1, Math.min(1, (trace - 1) / 2)));
  };
  const whole = angle(from.pose, to.pose);
  assert.deepEqual([between(from, to, 0), between(from, to, 1)], [from, to]);
  for (const share of [0.01, 0.3, 0.5, 0.99]) {
    const { pose } = between(from, to, share);
    near([angle(from.pose, pose)], [share * whole], 1e-6);
    near(cross(pose.right, pose.down), pose.forward);
    near(axes(pose).map(length), [1, 1, 1]);
    if (share === 0.01) assert.ok(length(subtract(pose.position, from.pose.position)) < 3);
  }
});

test("a focus turns around what was tapped, or around a nearer centre", () => {
  const { motion, orbit, run } = moving(dome());
  const point = [0.6, 0.3, 4.4];
  motion.focusOn(point);
  run(0, 2000);
  for (const turn of [() => {}, () => motion.turn(0.4, 0.1)]) {
    turn();
    near(orbit.centre, point);
    const towards = subtract(point, orbit.pose.position);
    near(orbit.pose.forward, times(towards, 1 / length(towards)), 1e-6);
  }
  const far = moving();
  far.motion.focusOn([1, 1, 90]);
  far.run(0, 2000);
  assert.ok(length(subtract(far.orbit.centre, SCENE)) <= 4 + 1e-6);
  assert.ok(size(far.motion.excess) < 1e-3);
});

test("in fly mode keys move the camera, and drags turn it on the spot", () => {
  const { motion, orbit, keys, run, lift } = moving();
  keys.g();
  assert.ok(motion.isFlying);
  keys.w();
  run(0, 1000);
  assert.ok(motion.isMoving);
  lift("w");
  run(1000, 2000);
  // Half of the rig's distance per second, minus the time to accelerate, plus the way to stop.
  near([orbit.pose.position[2]], [2], 0.1);
  assert.ok(!motion.isMoving);
  const { position } = orbit.pose;
  motion.turn(0.5, 0.1);
  near(orbit.pose.position, position);
  keys.g();
  near(orbit.pose.position, position);
  assert.ok(!motion.isFlying && distanceOf(orbit) > 0);
  const pushed = moving();
  pushed.keys["shift+d"]();
  pushed.run(0, 200);
  pushed.lift("Shift");
  pushed.run(200, 900);
  assert.ok(!pushed.motion.isFlying && !pushed.motion.isMoving);
  assert.ok(pushed.orbit.pose.position[0] > 0.2);
});

test("links hold every view", () => {
  for (const move of [
    ({ motion }) => {
      motion.turn(0.3, -0.2);
      motion.approach(2);
      motion.dragPan(30, 20, 500, 0);
    },
    ({ motion, run }) => {
      motion.flyToCamera(3);
      run(0, 300);
    },
    ({ motion, run }) => {
      motion.flyToCamera(3);
      run(0, 900);
      motion.turn(0.3, 0.1);
    },
    ({ motion, keys, run }) => {
      keys.g();
      keys.w();
      run(0, 300);
      motion.turn(0.3, 0.2);
    },
  ]) {
    const [found, again] = [moving(dome()), moving(dome())];
    move(found);
    again.orbit.text = found.orbit.text;
    near(again.orbit.pose.position, found.orbit.pose.position, 2e-3);
    near(again.orbit.pose.forward, found.orbit.pose.forward, 1e-3);
  }
  for (const text of ["", "1,2", "a,b,c,d,e", "1,2,3,4,1e300", "0,0,0,0,0,0,0,0,0,0"]) {
    const { orbit } = moving(dome());
    orbit.text = text;
    assert.equal(orbit.text, "0,0,1,0,0");
  }
});

test("a phone that is turned", () => {
  const turned = (from, to) => turnBetween(deviceTurn(...from), deviceTurn(...to));
  near([deviceTurn(0, 90, 0).pitchRad], [0]);
  near(turned([0, 90, 0], [30, 90, 0]), [30 * RAD_PER_DEG, 0]);
  near(turned([350, 90, 0], [10, 70, 0]), [20 * RAD_PER_DEG, -20 * RAD_PER_DEG]);
  assert.equal(deviceTurn(0, 0, 0).headingRad, null);
  near(turned([0, 0, 0], [30, 90, 0]), [0, 90 * RAD_PER_DEG]);
  // Held sideways, the same turn has other angles; here the top of the phone points left.
  near(turned([90, 0, -90], [120, 0, -90]), [30 * RAD_PER_DEG, 0]);
});

test("a model turns slowly all around, and before a rig the camera sways within its bounds", () => {
  for (const [scene, isFree] of [
    [model(), true],
    [wall(), false],
  ]) {
    const motion = new CameraMotion(scene);
    const turntable = new Turntable(motion);
    const turns = [];
    for (let ms = 0; ms <= 30_000; ms += 20) {
      turntable.step(ms);
      turns.push(motion.orbit.turnRad);
    }
    near([turns[50]], [isFree ? 0.25 : 0.15 * Math.sin(0.25 / 0.15)], 1e-6);
    near([Math.max(...turns)], [isFree ? 7.5 : 0.15], 1e-3);
    turntable.step(90_000); // a page that was hidden does not jump
    assert.ok(Math.abs(motion.orbit.turnRad - turns.at(-1)) <= 0.025 + 1e-9);
  }
});
