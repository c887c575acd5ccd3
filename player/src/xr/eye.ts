/** What an eye of a headset sees: a pinhole whose principal point may lie anywhere. */
import type { PinholeCamera } from "../geometry/camera";
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
  return {
    width,
    height,
    fx: (p[0] * width) / 2,
    fy: (p[5] * height) / 2,
    cx: ((1 - p[8]) * width) / 2,
    cy: ((1 + p[9]) * height) / 2,
    // Nothing nearer than half a hand before the eyes, in units of the scene.
    near: 0.05 * placement.scale,
    worldToCamera: standing(matrix, placement),
  };
}
