/** What an eye of a headset sees: a pinhole whose principal point may lie anywhere. */
import { lensOf, type PinholeCamera } from "../geometry/camera";
import { dot, times, type Matrix, type Vector } from "../geometry/vectors";
import type { Placement } from "./placement";

/** `matrix`: from the eye to the room, by columns; `projection`: OpenGL's, by columns. */
export interface Eye {
  readonly matrix: ArrayLike<number>;
  readonly projection: ArrayLike<number>;
  readonly width: number;
  readonly height: number;
}

const column = (matrix: ArrayLike<number>, at: number): Vector => [matrix[4 * at], matrix[4 * at + 1], matrix[4 * at + 2]];

export function positionOf(matrix: ArrayLike<number>): Vector {
  return column(matrix, 3);
}

export function backOf(matrix: ArrayLike<number>): Vector {
  return column(matrix, 2);
}

/** World-to-camera, three rows of four, of an eye in the scene. */
export function standing(matrix: ArrayLike<number>, placement: Placement): readonly (readonly [number, number, number, number])[] {
  const centre = placement.point(positionOf(matrix));
  const axes: Matrix = [
    placement.direction(column(matrix, 0)),
    times(placement.direction(column(matrix, 1)), -1),
    times(placement.direction(column(matrix, 2)), -1),
  ];
  return axes.map((axis) => [...axis, -dot(axis, centre)] as const);
}

export function cameraOf({ matrix, projection: p, width, height }: Eye, placement: Placement): PinholeCamera {
  // Nothing nearer than half a hand before the eyes, in units of the scene.
  return { ...lensOf(p, width, height, 0.05 * placement.scale), worldToCamera: standing(matrix, placement) };
}
