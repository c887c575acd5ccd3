/** A stream's cameras and sounds in the world that it is shown in (SPEC section 4, "Presentation"). */
import type { RigCamera, StreamHeader } from "../scene";
import type { Similarity } from "./similarity";
import { applied, dot, plus, product, times, transposed, type Matrix, type Vector } from "./vectors";

/** The header with its cameras and sounds where its transform takes them; the very object where it has none. */
export function inItsWorld(header: StreamHeader): StreamHeader {
  const { transform } = header.presentation;
  if (transform === null) return header;
  const sound = header.sound.map((track) => ({ ...track, position: track.position && moved(track.position, transform) }));
  return { ...header, cameras: header.cameras.map((camera) => transformed(camera, transform)), sound };
}

function moved(point: Vector, { rotation, scale, shift }: Similarity): Vector {
  return plus(times(applied(rotation, point), scale), shift);
}

/** The camera shows of the transformed scene what it showed of the scene. */
function transformed(camera: RigCamera, { rotation, scale, shift }: Similarity): RigCamera {
  const axes = product(axesOf(camera.worldToCamera), transposed(rotation));
  const worldToCamera = axes.map((axis, i) => [...axis, scale * camera.worldToCamera[i][3] - dot(axis, shift)]);
  return { ...camera, worldToCamera, near: scale * camera.near };
}

function axesOf(rows: readonly (readonly number[])[]): Matrix {
  return rows.map(([x, y, z]) => [x, y, z] as const) as unknown as Matrix;
}
