/** A camera as text: a pose file for `decogs-decode --camera` (docs/cameras.md), and the end of a link. */
import type { Lens, PinholeCamera } from "../geometry/camera";
import type { Pose } from "../geometry/poses";
import { cross, dot, length, unit, type Vector } from "../geometry/vectors";

export function poseFile(camera: PinholeCamera): string {
  const { width, height, fx, fy, cx, cy, near } = camera;
  const rows = [...camera.worldToCamera, [0, 0, 0, 1]];
  const matrix = rows.map((row) => `    [${row.join(", ")}]`).join(",\n");
  const lens = JSON.stringify({ width, height, fx, fy, cx, cy, near }).slice(1, -1).replace(/:/g, ": ").replace(/,/g, ", ");
  return `{\n  ${lens},\n  "world_to_camera": [\n${matrix}\n  ]\n}\n`;
}

const DIGITS = 6;
const NUMBERS = 16;

/** Centre, right and forward axis, then the lens: enough to see the same in a window of any size. */
export function cameraToLink({ axes, centre }: Pose, lens: Lens): string {
  const { width, height, fx, fy, cx, cy, near } = lens;
  const numbers = [...centre, ...axes[0], ...axes[2], width, height, fx, fy, cx, cy, near];
  return numbers.map((number) => Number(number.toPrecision(DIGITS)).toString()).join(",");
}

/** The camera in a link; null when there is none that could be looked through. */
export function cameraFromLink(text: string): { readonly pose: Pose; readonly lens: Lens } | null {
  const numbers = text.split(",").map(Number);
  if (numbers.length !== NUMBERS || !numbers.every(Number.isFinite)) return null;
  const vector = (at: number): Vector => [numbers[at], numbers[at + 1], numbers[at + 2]];
  const [width, height, fx, fy, cx, cy, near] = numbers.slice(9) as [number, number, number, number, number, number, number];
  if (!(width > 0 && height > 0 && fx > 0 && fy > 0 && near >= 0)) return null;
  const [right, forward] = [vector(3), vector(6)];
  const down = cross(forward, right);
  if (!(length(down) > 0.5) || Math.abs(dot(right, forward)) > 0.1) return null;
  const z = unit(forward);
  const y = unit(cross(z, right));
  return { pose: { axes: [cross(y, z), y, z], centre: vector(0) }, lens: { width, height, fx, fy, cx, cy, near } };
}
