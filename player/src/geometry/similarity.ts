/** A turn, a scale and a shift: what takes a scene as it is stored to the world that it is shown in (SPEC section 4, "Presentation"). */
import type { PinholeCamera } from "./camera";
import { applied, dot, minus, times, transposed, type Matrix, type Vector } from "./vectors";

/** x becomes `scale` `rotation` x + `shift`. */
export interface Similarity {
  readonly rotation: Matrix;
  readonly scale: number;
  readonly shift: Vector;
}

type Row = readonly [number, number, number, number];

/** A camera of the world as what draws takes it, which has the scene as it is stored: the same picture. */
export function intoScene(camera: PinholeCamera, by: Similarity | null): PinholeCamera {
  if (by === null) return camera;
  const worldToCamera = camera.worldToCamera.map((row) => rowIntoScene(row as Row, by));
  return { ...camera, worldToCamera, near: camera.near / by.scale };
}

/** A row of world-to-camera, in lengths of the scene. */
export function rowIntoScene(row: Row, by: Similarity | null): Row {
  if (by === null) return row;
  const axis: Vector = [row[0], row[1], row[2]];
  return [...applied(transposed(by.rotation), axis), (row[3] + dot(axis, by.shift)) / by.scale];
}

/** A point of the world where the scene has it. */
export function pointIntoScene(point: Vector, by: Similarity | null): Vector {
  return by === null ? point : times(applied(transposed(by.rotation), minus(point, by.shift)), 1 / by.scale);
}
