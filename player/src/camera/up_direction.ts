/**
 * Which way is up in a rig's world: the rule of formats/geometry/up_direction.py, where its reasons are. The same cases test both
 * (tests/camera/up_cases.json).
 */
import { dot, length, minus, symmetricEigen, times, unit, type Matrix, type Vector } from "../geometry/vectors";
import { poseOf } from "../geometry/poses";

const AXES: readonly Vector[] = [
  [1, 0, 0],
  [-1, 0, 0],
  [0, 1, 0],
  [0, -1, 0],
  [0, 0, 1],
  [0, 0, -1],
];
const NEAR_AN_AXIS = Math.cos((5 * Math.PI) / 180);
const NEAR_AN_AXIS_BY_THE_MEAN = Math.cos((15 * Math.PI) / 180);
const MOST_ROLL = Math.sin((8 * Math.PI) / 180);
const SPREAD = 0.17;

interface Posed {
  readonly worldToCamera: readonly (readonly number[])[];
}

/** The world's up, a unit vector, as the cameras tell it; -Y, as in COLMAP's worlds, where they do not. */
export function upOf(cameras: readonly Posed[]): Vector {
  const axes = cameras.map((camera) => poseOf(camera).axes);
  const sum = axes.reduce<Vector>((up, [, down]) => minus(up, down), [0, 0, 0]);
  if (length(sum) < 1e-6 * Math.max(1, axes.length)) return [0, -1, 0];
  const mean = unit(sum);
  const level = levelWith(
    axes.map(([right]) => right),
    mean,
  );
  const up = level ?? mean;
  const nearest = AXES.reduce((best, axis) => (dot(axis, up) > dot(best, up) ? axis : best));
  return dot(nearest, up) > (level === null ? NEAR_AN_AXIS_BY_THE_MEAN : NEAR_AN_AXIS) ? nearest : up;
}

/** The direction to which all x axes are most nearly perpendicular, on the side of the mean up; null where cameras roll. */
function levelWith(rights: readonly Vector[], meanUp: Vector): Vector | null {
  const entry = (i: number, k: number): number => rights.reduce((sum, right) => sum + right[i] * right[k], 0);
  const gram = [0, 1, 2].map((i) => [entry(i, 0), entry(i, 1), entry(i, 2)]) as unknown as Matrix;
  const directions = symmetricEigen(gram);
  const spread = directions.map(({ value }) => Math.sqrt(Math.max(0, value) / rights.length));
  if (spread[1] > SPREAD) {
    if (spread[2] > MOST_ROLL) return null;
    const up = directions[2].vector;
    return unit(dot(up, meanUp) > 0 ? up : times(up, -1));
  }
  // All look the same way: level with their x axis is a plane, of which the mean up says the rest.
  const right = directions[0].vector;
  return unit(minus(meanUp, times(right, dot(meanUp, right))));
}
