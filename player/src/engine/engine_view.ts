/** A camera of an engine, in OpenGL's conventions, as what draws takes it. */
import { lensOf, type PinholeCamera } from "../geometry/camera";
import { poseOf, type Pose } from "../geometry/poses";
import { intoScene, type Similarity } from "../geometry/similarity";
import { cross, dot, length, type Matrix, type Vector } from "../geometry/vectors";

/** What an engine draws at the moment; matrices by columns, y up and z back. */
export interface EngineView {
  /** From the object to the camera: turned, shifted, and scaled alike in all directions. */
  readonly modelView: ArrayLike<number>;
  readonly projection: ArrayLike<number>;
  /** Whether the target is upside down, as PlayCanvas has some. */
  readonly flipped?: boolean;
  /** Whether the target holds light, not what screens show: colours are then converted, and blend as light. */
  readonly linear?: boolean;
}

export interface EngineCamera {
  readonly camera: PinholeCamera;
  /** Where it stands in the stream's world. */
  readonly pose: Pose;
  /** Depth of a pixel at distance z in the scene: the first plus the second divided by z. */
  readonly depth: readonly [number, number];
}

/** How far scales may differ: engines multiply matrices of float32. */
const ALIKE = 1e-3;

/**
 * null for what has no size. Throws an Error that says so for cameras and objects that cannot be drawn. `transform`: the stream's, from the
 * scene as it is stored.
 */
export function engineCamera({ modelView: m, projection: p }: EngineView, width: number, height: number, transform: Similarity | null): EngineCamera | null {
  if (p[15] !== 0) throw new Error("an orthographic camera draws no .dgs stream: use one with perspective");
  const rows = [0, 1, 2].map((row) => [m[row], m[4 + row], m[8 + row]] as const) as unknown as Matrix;
  const scale = Math.cbrt(dot(rows[0], cross(rows[1], rows[2])));
  if (scale === 0) return null;
  if (!rows.every((row) => Math.abs(length(row) / scale - 1) < ALIKE)) throw new Error("a .dgs stream is scaled alike in all directions, and not mirrored");
  const worldToCamera = rows.map((row: Vector, i) => [...row, m[12 + i]].map((value) => ((i === 0 ? 1 : -1) * value) / scale));
  // The engine's own near plane cuts.
  const camera: PinholeCamera = { ...lensOf(p, width, height, 0), worldToCamera };
  return { camera: intoScene(camera, transform), pose: poseOf(camera), depth: [-p[10], p[14] / (scale * (transform?.scale ?? 1))] };
}
