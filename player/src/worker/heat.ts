/** When each Gaussian last changed, as a byte that the page colours: see `HEAT` in messages.ts. */
import { HEAT, TEXTURE_WIDTH, textureLines } from "../messages";
import type { SceneFrame } from "../scene";
import type { Buffers } from "./buffers";

/** Frames after which a change no longer glows. */
export const FADE_FRAMES = 12;

/** A byte for each Gaussian, as long as the lines of a texture that hold them. */
export function heatOf(scene: SceneFrame, buffers: Buffers): Uint8Array {
  const { count, lastChanged } = scene.gaussians;
  const bytes = buffers.bytes(TEXTURE_WIDTH * textureLines(count, 1));
  if (lastChanged === undefined) return bytes.fill(HEAT.still);
  // The oldest are what no packet has touched since the keyframe, unless every one has been: then all is moving anyway.
  let keyframe = scene.frame;
  for (let place = 0; place < count; place++) keyframe = Math.min(keyframe, lastChanged[place]);
  for (let place = 0; place < count; place++) {
    const last = lastChanged[place];
    bytes[place] = last <= keyframe ? HEAT.still : heatOfAge(scene.frame - last);
  }
  return bytes;
}

function heatOfAge(age: number): number {
  return age >= FADE_FRAMES ? HEAT.earlier : Math.max(HEAT.oldest, Math.round(HEAT.now * (1 - age / FADE_FRAMES)));
}
