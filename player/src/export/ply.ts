/** A frame as a .ply of 3D Gaussians, as decogs-export writes it with `--up none`. */
import type { Gaussians, StreamHeader } from "../scene";
import { splatElement } from "./elements";

/** Programs that draw ply files expect them; the render mode says how their sizes are meant. */
const NORMALS = ["nx", "ny", "nz"];
const POSITIONS = 3;

export function plyOf(gaussians: Gaussians, header: StreamHeader): Uint8Array<ArrayBuffer> {
  const [{ count, properties }] = splatElement(gaussians, header);
  const names = properties.map(({ name }) => name);
  names.splice(POSITIONS, 0, ...NORMALS);
  const listed = names.map((name) => `property float ${name}\n`).join("");
  const text = `ply\nformat binary_little_endian 1.0\ncomment SplatRenderMode: mip\nelement vertex ${count}\n${listed}end_header\n`;
  const head = new TextEncoder().encode(text);
  const bytes = new Uint8Array(head.length + 4 * count * names.length);
  bytes.set(head);
  const values = new DataView(bytes.buffer, head.length);
  properties.forEach(({ storage }, i) => {
    const column = i < POSITIONS ? i : i + NORMALS.length;
    for (let row = 0; row < count; row++) values.setFloat32(4 * (row * names.length + column), storage[row], true);
  });
  return bytes;
}
