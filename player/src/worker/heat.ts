/** When each Gaussian last changed, as a byte that the page colours: see `HEAT` in messages.ts. */
import { HEAT, TEXTURE_WIDTH, textureLines } from "../messages";
import type { SceneFrame } from "../scene";
import type { Buffers } from "./buffers";

/** Frames after which a change no longer glows. */
export const FADE_FRAMES = 12;

/** By age: a table, since this is done for every Gaussian in every frame. */
const GLOW = Uint8Array.from({ length: FADE_FRAMES }, (_, age) =>
  Math.max(HEAT.oldest, Math.round(HEAT.now * (1 - age / FADE_FRAMES))),
);

/** A byte for each Gaussian, as long as the lines of a texture that hold them. */
export function heatOf(scene: SceneFrame, buffers: Buffers): Uint8Array {
  const { count, lastChanged } = scene.gaussians;
  const bytes = buffers.bytes(TEXTURE_WIDTH * textureLines(count, 1));
  if (lastChanged === undefined || scene.kind === "key") return bytes.fill(HEAT.still);
  // The oldest are what no packet has touched since the keyframe, unless every one has been: then all is moving anyway.
  let keyframe = scene.frame;
  for (let slot = 0; slot < count; slot++) if (lastChanged[slot] < keyframe) keyframe = lastChanged[slot];
  for (let slot = 0; slot < count; slot++) {
    const last = lastChanged[slot];
    const age = scene.frame - last;
    bytes[slot] = last <= keyframe ? HEAT.still : age < FADE_FRAMES ? GLOW[age] : HEAT.earlier;
  }
  return bytes;
}
