/** A frame's Gaussians as a .ply of 3D Gaussians has them, in the world that the stream is shown in. */
import type { Gaussians, StreamHeader } from "../scene";
import { shRotation } from "./sh_rotation";
import { quaternionOf } from "./quaternions";
import type { Similarity } from "../geometry/similarity";

export interface SplatProperty {
  readonly name: string;
  readonly type: "float";
  readonly storage: Float32Array;
  readonly byteSize: 4;
}

export interface SplatElement {
  readonly name: "vertex";
  readonly count: number;
  readonly properties: SplatProperty[];
}

/** Values are those that decogs-export writes into .ply with `--up none`, in arrays of their own. */
export function splatElement(gaussians: Gaussians, { shDegree, presentation }: StreamHeader): [SplatElement] {
  const { count, order } = gaussians;
  const coefficients = (shDegree + 1) ** 2;
  const { means, logScales, quaternions, opacityLogits, sh } =
    presentation.transform === null ? gaussians : transformed(gaussians, coefficients, presentation.transform);
  const properties: SplatProperty[] = [];
  const add = (names: readonly string[], values: Float32Array, width: number, first = 0, step = 1): void => {
    names.forEach((name, n) => {
      const storage = new Float32Array(count);
      const channel = first + n * step;
      for (let row = 0; row < count; row++) storage[row] = values[width * (order === null ? row : order[row]) + channel];
      properties.push({ name, type: "float", storage, byteSize: 4 });
    });
  };
  const width = 3 * coefficients;
  const rest = coefficients - 1;
  add(["x", "y", "z"], means, 3);
  add(numbered("f_dc", 3), sh, width);
  // In .ply all coefficients of red come first, then green's, then blue's.
  const names = numbered("f_rest", 3 * rest);
  for (let colour = 0; colour < 3; colour++) {
    add(names.slice(colour * rest, (colour + 1) * rest), sh, width, 3 + colour, 3);
  }
  add(["opacity"], opacityLogits, 1);
  add(numbered("scale", 3), logScales, 3);
  add(numbered("rot", 4), quaternions, 4);
  return [{ name: "vertex", count, properties }];
}

function numbered(name: string, count: number): string[] {
  return Array.from({ length: count }, (_, n) => `${name}_${n}`);
}

/** As `transformed_splats` in formats/geometry/similarity.py: in float64, rounded once. */
function transformed(gaussians: Gaussians, coefficients: number, { rotation, scale, shift }: Similarity): Gaussians {
  const slots = Math.max(gaussians.count, gaussians.order?.reduce((most, slot) => Math.max(most, slot + 1), 0) ?? 0);
  const linear = rotation.map((row) => row.map((value) => scale * value));
  const [w, x, y, z] = quaternionOf(rotation);
  const turn = [
    [w, -x, -y, -z],
    [x, w, -z, y],
    [y, z, w, -x],
    [z, -y, x, w],
  ];
  const rise = Math.log(scale);
  return {
    ...gaussians,
    means: multiplied(gaussians.means, slots, linear, 1, shift),
    logScales: gaussians.logScales.slice(0, 3 * slots).map((value) => value + rise),
    quaternions: multiplied(gaussians.quaternions, slots, turn, 1),
    sh: multiplied(gaussians.sh, slots, shRotation(Math.sqrt(coefficients) - 1, rotation), 3),
  };
}

/** Of each of so many Gaussians, the matrix times its values, which are rows of `step` numbers, plus a shift. */
function multiplied(values: Float32Array, slots: number, matrix: readonly (readonly number[])[], step: number, shift?: readonly number[]): Float32Array {
  const size = matrix.length;
  const result = new Float32Array(slots * size * step);
  for (let slot = 0; slot < slots; slot++) {
    const from = slot * size * step;
    for (let row = 0; row < size; row++) {
      for (let part = 0; part < step; part++) {
        let sum = shift?.[row] ?? 0;
        for (let column = 0; column < size; column++) sum += matrix[row][column] * values[from + column * step + part];
        result[from + row * step + part] = sum;
      }
    }
  }
  return result;
}
