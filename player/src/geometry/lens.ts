/** Lens distortion, backwards: the direction that a point of a distorted picture comes from (decoder/cameras/lens.py). */

const NEWTON_STEPS = 15;
const CONVERGED = 1e-12;
/** A direction is found when the lens puts it back this close, in units of the focal length. */
const SAME = 1e-6;
/** Radii beyond this are not looked at for a fold: 86 degrees off the axis. */
const FARTHEST = 16;
const FOLD_STEPS = 4096;
/** A pinhole cannot see 90 degrees off its axis, whatever the lens can. */
const WIDEST_ANGLE = Math.PI / 2 - 1e-3;

/** From a distorted point in normalised coordinates (x/z, y/z) to the undistorted one; null where no direction falls. */
export type Straighten = (x: number, y: number) => readonly [number, number] | null;

export interface LensModel {
  readonly distortionModel: "none" | "opencv" | "fisheye";
  readonly distortion: readonly number[];
}

export function isDistorted({ distortionModel, distortion }: LensModel): boolean {
  return distortionModel === "fisheye" || distortion.some((coefficient) => coefficient !== 0);
}

export function straightening({ distortionModel, distortion }: LensModel): Straighten {
  return distortionModel === "fisheye" ? fisheye(distortion) : brownConrady(distortion);
}

/** OpenCV's standard model: radial and rational terms, and tangential ones, in the order k1 k2 p1 p2 k3 k4 k5 k6. */
function brownConrady(coefficients: readonly number[]): Straighten {
  const [k1, k2, p1, p2, k3, k4, k5, k6] = Array.from({ length: 8 }, (_, i) => coefficients[i] ?? 0) as unknown as
    readonly [number, number, number, number, number, number, number, number];
  const radial = (s: number): readonly [number, number] => {
    const below = 1 + s * (k4 + s * (k5 + s * k6));
    const value = (1 + s * (k1 + s * (k2 + s * k3))) / below;
    const slope = (k1 + s * (2 * k2 + 3 * s * k3) - value * (k4 + s * (2 * k5 + 3 * s * k6))) / below;
    return [value, slope];
  };
  // The distorted radius r R(s) grows up to the fold, or to a pole; beyond it, far directions would appear again.
  const reach = firstFall((r) => {
    const [value, slope] = radial(r * r);
    return value > 0 && value + 2 * r * r * slope > 0;
  }, FARTHEST);
  return (x, y) => {
    let [u, v] = [x, y];
    for (let left = NEWTON_STEPS; ; left--) {
      const s = u * u + v * v;
      const [value, slope] = radial(s);
      const errorU = u * value + 2 * p1 * u * v + p2 * (s + 2 * u * u) - x;
      const errorV = v * value + p1 * (s + 2 * v * v) + 2 * p2 * u * v - y;
      const missed = Math.abs(errorU) + Math.abs(errorV);
      if (left === 0 || !(missed > CONVERGED)) return missed < SAME && s < reach * reach ? [u, v] : null;
      const uu = value + 2 * u * u * slope + 2 * p1 * v + 6 * p2 * u;
      const vv = value + 2 * v * v * slope + 6 * p1 * v + 2 * p2 * u;
      const off = 2 * u * v * slope + 2 * p1 * u + 2 * p2 * v;
      const determinant = uu * vv - off * off;
      u -= (vv * errorU - off * errorV) / determinant;
      v -= (uu * errorV - off * errorU) / determinant;
    }
  };
}

/** OpenCV's fisheye model: the distorted radius is a polynomial of the angle to the optical axis. */
function fisheye([k1, k2, k3, k4]: readonly number[]): Straighten {
  const slope = (angle: number): number => {
    const s = angle * angle;
    return 1 + s * (3 * k1 + s * (5 * k2 + s * (7 * k3 + s * 9 * k4)));
  };
  const widest = firstFall((angle) => slope(angle) > 0, WIDEST_ANGLE);
  return (x, y) => {
    const bent = Math.hypot(x, y);
    if (bent === 0) return [x, y];
    let angle = Math.min(bent, widest);
    for (let left = NEWTON_STEPS; ; left--) {
      const s = angle * angle;
      const error = angle * (1 + s * (k1 + s * (k2 + s * (k3 + s * k4)))) - bent;
      if (left === 0 || !(Math.abs(error) > CONVERGED)) {
        const factor = Math.tan(angle) / bent;
        return Math.abs(error) < SAME ? [x * factor, y * factor] : null;
      }
      angle = Math.min(widest, Math.max(0, angle - error / slope(angle)));
    }
  };
}

/** Where something that holds at 0 first does not, up to `end`. */
function firstFall(holds: (at: number) => boolean, end: number): number {
  for (let step = 1; step <= FOLD_STEPS; step++) {
    if (holds((step * end) / FOLD_STEPS)) continue;
    let [low, high] = [((step - 1) * end) / FOLD_STEPS, (step * end) / FOLD_STEPS];
    for (let i = 0; i < 50; i++) {
      const middle = (low + high) / 2;
      if (holds(middle)) low = middle;
      else high = middle;
    }
    return low;
  }
  return end;
}
