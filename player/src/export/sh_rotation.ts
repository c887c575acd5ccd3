/** How spherical harmonics turn with a scene: `sh_rotation` of formats/geometry/spherical_harmonics.py, from as many directions as unknowns. */
import { applied, transposed, unit, type Matrix, type Vector } from "../geometry/vectors";

/** Far from each other and from each other's opposites: a system of seven is well conditioned. */
const DIRECTIONS: readonly Vector[] = (
  [
    [0.2, 0.3, 1],
    [1, 0.1, -0.2],
    [-0.3, 1, 0.4],
    [0.8, -0.7, 0.5],
    [-0.6, -0.5, 0.9],
    [0.5, 0.8, 0.7],
    [-0.9, 0.4, -0.6],
  ] as const
).map(unit);

/** The matrix, (degree + 1)^2 rows, that turns coefficients as `rotation` turns the scene; each degree turns by itself. */
export function shRotation(degree: number, rotation: Matrix): number[][] {
  const size = (degree + 1) ** 2;
  const turned = Array.from({ length: size }, () => new Array<number>(size).fill(0));
  const back = transposed(rotation);
  for (let band = 0; band <= degree; band++) {
    const [first, width] = [band ** 2, 2 * band + 1];
    const seen = DIRECTIONS.slice(0, width);
    const before = seen.map((direction) => basis(direction).slice(first, first + width));
    const after = seen.map((direction) => basis(applied(back, direction)).slice(first, first + width));
    solve(before, after).forEach((row, i) => {
      row.forEach((value, j) => (turned[first + i][first + j] = value));
    });
  }
  return turned;
}

/** Real harmonics up to degree 3, as 3D Gaussian Splatting has them. */
function basis([x, y, z]: Vector): number[] {
  const [xx, yy, zz] = [x * x, y * y, z * z];
  return [
    0.28209479177387814,
    -0.4886025119029199 * y,
    0.4886025119029199 * z,
    -0.4886025119029199 * x,
    1.0925484305920792 * x * y,
    -1.0925484305920792 * y * z,
    0.31539156525252005 * (2 * zz - xx - yy),
    -1.0925484305920792 * x * z,
    0.5462742152960396 * (xx - yy),
    -0.5900435899266435 * y * (3 * xx - yy),
    2.890611442640554 * x * y * z,
    -0.4570457994644658 * y * (4 * zz - xx - yy),
    0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
    -0.4570457994644658 * x * (4 * zz - xx - yy),
    1.445305721320277 * z * (xx - yy),
    -0.5900435899266435 * x * (xx - 3 * yy),
  ];
}

/** X with `left` X = `right`, by Gauss and Jordan; both are changed. */
function solve(left: number[][], right: number[][]): number[][] {
  const size = left.length;
  for (let at = 0; at < size; at++) {
    let pivot = at;
    for (let row = at + 1; row < size; row++) if (Math.abs(left[row][at]) > Math.abs(left[pivot][at])) pivot = row;
    [left[at], left[pivot], right[at], right[pivot]] = [left[pivot], left[at], right[pivot], right[at]];
    const by = 1 / left[at][at];
    for (const rows of [left, right]) rows[at] = rows[at].map((value) => value * by);
    for (let row = 0; row < size; row++) {
      const factor = left[row][at];
      if (row === at || factor === 0) continue;
      for (const rows of [left, right]) rows[row] = rows[row].map((value, column) => value - factor * rows[at][column]);
    }
  }
  return right;
}
