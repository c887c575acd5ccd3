/** The point that a rig's cameras look at: what one orbits about (decoder/cameras/moves.py has the same). */
import { applied, dot, length, minus, plus, solved, symmetricEigen, times, unit, type Matrix, type Vector } from "../geometry/vectors";
import type { Pose } from "../geometry/poses";

/** The point nearest to all optical axes, before the cameras; parallel axes have none: then one before the rig's centre. */
export function lookedAt(poses: readonly Pose[]): Vector {
  const centres = poses.map(({ centre }) => centre);
  const forwards = poses.map(({ axes }) => axes[2]);
  const across = forwards.map(acrossOf);
  const normal = across.reduce(sumOf);
  const values = symmetricEigen(normal).map(({ value }) => value);
  if (values[2] > 0 && values[0] / values[2] < 1e4) {
    const right = across.map((matrix, i) => applied(matrix, centres[i])).reduce(plus);
    const point = solved(normal, right);
    const ahead = forwards.reduce((sum, forward, i) => sum + dot(minus(point, centres[i]), forward), 0);
    if (ahead > 0) return point;
  }
  const middle = times(centres.reduce(plus), 1 / poses.length);
  const forward = forwards.reduce(plus);
  const direction = length(forward) > 1e-9 ? unit(forward) : forwards[0];
  return plus(middle, times(direction, extentOf(centres) || 1));
}

/** The diagonal of the box around points. */
export function extentOf(points: readonly Vector[]): number {
  const side = (axis: number): number => {
    const values = points.map((point) => point[axis]);
    return values.reduce((a, b) => Math.max(a, b)) - values.reduce((a, b) => Math.min(a, b));
  };
  return Math.hypot(side(0), side(1), side(2));
}

/** What takes the part along a direction out of a vector. */
function acrossOf(direction: Vector): Matrix {
  const row = (i: 0 | 1 | 2): Vector => {
    const along = times(direction, -direction[i]);
    return [along[0] + (i === 0 ? 1 : 0), along[1] + (i === 1 ? 1 : 0), along[2] + (i === 2 ? 1 : 0)];
  };
  return [row(0), row(1), row(2)];
}

const sumOf = (a: Matrix, b: Matrix): Matrix => [plus(a[0], b[0]), plus(a[1], b[1]), plus(a[2], b[2])];
