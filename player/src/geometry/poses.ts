/** Where a camera stands and how it is turned, and what follows for its picture. */
import type { RigCamera } from "../scene";
import type { Lens } from "./camera";
import { applied, cross, dot, length, minus, times, transposed, unit, type Matrix, type Vector } from "./vectors";

/** `axes`: the camera's x (right), y (down) and z (forward) in the world: the rotation of world-to-camera. */
export interface Pose {
  readonly axes: Matrix;
  readonly centre: Vector;
  /** Of a camera of the rig that nobody has moved: its very numbers, which the exact picture needs. */
  readonly given?: readonly (readonly number[])[];
}

export function poseOf(camera: { readonly worldToCamera: readonly (readonly number[])[] }): Pose {
  const rows = camera.worldToCamera as readonly (readonly [number, number, number, number])[];
  const axes = rows.slice(0, 3).map(([x, y, z]) => [x, y, z] as const) as unknown as Matrix;
  const shift: Vector = [rows[0][3], rows[1][3], rows[2][3]];
  return { axes, centre: times(applied(transposed(axes), shift), -1), given: rows };
}

/** Three rows of four. */
export function worldToCamera({ axes, centre, given }: Pose): [number, number, number, number][] {
  if (given !== undefined) return given.map((row) => [row[0], row[1], row[2], row[3]]);
  return axes.map((axis) => [axis[0], axis[1], axis[2], -dot(axis, centre)]);
}

/** The axes of a camera at `centre` that has `target` in its middle and `up` upwards. */
export function lookingAxes(centre: Vector, target: Vector, up: Vector): Matrix {
  const forward = unit(minus(target, centre));
  let right = cross(forward, up);
  if (length(right) < 1e-6) right = cross(forward, Math.abs(forward[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]);
  right = unit(right);
  return [right, cross(forward, right), forward];
}

export function lensOf({ width, height, fx, fy, cx, cy, near }: RigCamera): Lens {
  return { width, height, fx, fy, cx, cy, near };
}

/** How much larger than "all of it is to be seen" a picture gets in a window of very different shape, such as a phone's. */
const MOST_CROPPED = 1.4;

/**
 * The lens in a window of another size: the camera's picture in the middle, as large as it fits, and what is beside it
 * in the scene around it.
 */
export function fittedLens(lens: Lens, width: number, height: number): Lens {
  const [across, down] = [width / lens.width, height / lens.height];
  const [fits, covers] = across < down ? [across, down] : [down, across];
  const scale = fits * Math.min(MOST_CROPPED, Math.max(1, covers / fits / MOST_CROPPED));
  return {
    width,
    height,
    fx: scale * lens.fx,
    fy: scale * lens.fy,
    // In this form nothing is rounded where the picture is exactly as large as the camera's.
    cx: scale * lens.cx + (width - scale * lens.width) / 2,
    cy: scale * lens.cy + (height - scale * lens.height) / 2,
    near: lens.near,
  };
}
