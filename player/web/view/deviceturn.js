/** Converts the orientation of a phone to turns of a camera. */

const RAD_PER_DEG = Math.PI / 180;
/** Below this horizontal part, the phone points almost straight up or down and has no heading. */
const LEAST_LEVEL = 0.2;

/**
 * The direction in which the back of a device points.
 * @typedef {object} DeviceTurn
 * @property {number | null} headingRad to the left, from an arbitrary zero; null: straight up or down
 * @property {number} pitchRad upwards
 */

/**
 * The turn of a DeviceOrientationEvent. All angles in degrees, in the order Z, X', Y''.
 * @param {number} alpha
 * @param {number} beta
 * @param {number} gamma
 * @returns {DeviceTurn}
 */
export function deviceTurn(alpha, beta, gamma) {
  const [a, b, c] = [alpha, beta, gamma].map((angle) => angle * RAD_PER_DEG);
  // The device's -z in axes east, north and up: the last column of Rz(a) Rx(b) Ry(c), negated.
  const east = -(Math.cos(a) * Math.sin(c) + Math.sin(a) * Math.sin(b) * Math.cos(c));
  const north = -(Math.sin(a) * Math.sin(c) - Math.cos(a) * Math.sin(b) * Math.cos(c));
  const up = -Math.cos(b) * Math.cos(c);
  return {
    headingRad: Math.hypot(east, north) < LEAST_LEVEL ? null : Math.atan2(-east, north),
    pitchRad: Math.asin(Math.min(Math.max(up, -1), 1)),
  };
}

/**
 * The camera turn that corresponds to a device's motion between two turns: left and up, radians.
 * @param {DeviceTurn} from
 * @param {DeviceTurn} to
 * @returns {[number, number]}
 */
export function turnBetween(from, to) {
  const left =
    from.headingRad === null || to.headingRad === null ? 0 : to.headingRad - from.headingRad;
  return [Math.atan2(Math.sin(left), Math.cos(left)), to.pitchRad - from.pitchRad];
}
