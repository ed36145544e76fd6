/**
 * Moves cameras with the code of player/web/view, for the tests: one JSON object a line in, one out.
 */
import { createInterface } from "node:readline";

import { Taps } from "../../../player/web/element/taps.js";
import { readManifest } from "../../../player/web/format/manifest.js";
import { boundsOf, excessOf } from "../../../player/web/view/bounds.js";
import { CameraMotion } from "../../../player/web/view/cameramotion.js";
import { cameraKeys, liftCameraKey } from "../../../player/web/view/camerakeys.js";
import { deviceTurn, turnBetween } from "../../../player/web/view/deviceturn.js";
import { between } from "../../../player/web/view/flight.js";
import { poseOf } from "../../../player/web/view/pose.js";
import { length, subtract } from "../../../player/web/view/vectors.js";

/** @param {string} text hexadecimal */
const manifestOf = (text) => readManifest(Uint8Array.from(Buffer.from(text, "hex")));

/** @type {Record<string, (question: any) => unknown>} */
const ANSWERS = {
  /** By how much the pose of each camera is out of the bounds, as all of them make these. */
  excesses({ manifest }) {
    const read = manifestOf(manifest);
    const bounds = boundsOf(read);
    const around = read.cameras.map((camera) => {
      const pose = poseOf(camera);
      return excessOf(bounds, pose, length(subtract(pose.position, bounds.centre)));
    });
    return { bounds, around };
  },
  /** How the camera stands after each step: [name, ...arguments], of the motion or a key. */
  moved({ manifest, steps, reduced }) {
    const motion = new CameraMotion(manifestOf(manifest), () => reduced);
    const keys = cameraKeys({ motion, moved() {} });
    return steps.map((/** @type {[string, ...any[]]} */ [what, ...args]) => {
      let answer = null;
      if (what === "key") keys[args[0]]();
      else if (what === "lift") liftCameraKey({ motion, moved() {} }, args[0]);
      else if (what === "text") motion.orbit.text = args[0];
      else if (what === "run") {
        // From one time to another, so many pictures a second.
        const [fromMs, toMs, perS] = args;
        const count = Math.round(((toMs - fromMs) * perS) / 1000);
        for (let n = 1; n <= count; n++) answer = motion.step(fromMs + (n * 1000) / perS);
      } else answer = /** @type {any} */ (motion)[what](...args) ?? null;
      const { orbit, excess, isMoving, isFlying, cameraIndex } = motion;
      const { pose, text, centre, distanceM } = orbit;
      return { answer, pose, text, centre, distanceM, excess, isMoving, isFlying, cameraIndex };
    });
  },
  between({ from, to, shares }) {
    return shares.map((/** @type {number} */ share) => between(from, to, share));
  },
  /** Which of some touches, [from ms, to ms, x, y, fingers], end double taps. */
  doubleTaps({ touches }) {
    const taps = new Taps();
    return touches.map((/** @type {number[]} */ [fromMs, toMs, clientX, clientY, numFingers]) => {
      taps.down({ clientX, clientY, timeStamp: fromMs }, numFingers);
      return taps.up({ clientX, clientY, timeStamp: toMs });
    });
  },
  deviceTurns({ angles }) {
    const turns = angles.map((/** @type {[number, number, number]} */ a) => deviceTurn(...a));
    return { turns, between: turnBetween(turns[0], turns[turns.length - 1]) };
  },
};

for await (const line of createInterface({ input: process.stdin })) {
  const question = JSON.parse(line);
  const value = ANSWERS[question.ask](question);
  process.stdout.write(`${JSON.stringify({ value })}\n`);
}
