/** What a camera's own picture has that is shown by a switch only (SPEC section 6, "Corrections"). */
import type { StreamHeader } from "../scene";

const EFFECTS: ReadonlyMap<string, string> = new Map([
  ["exposure_drift", "changing exposure"],
  ["white_balance_drift", "changing white balance"],
  ["camera_shake", "shaking"],
]);

/** A sentence; null when the picture is the camera's own. */
export function cameraNote(header: StreamHeader, name: string): string | null {
  const camera = header.cameras.find((each) => each.name === name);
  if (camera === undefined) return null;
  const missing: string[] = [];
  if (camera.distortionModel !== "none") missing.push("lens distortion");
  if (camera.colours !== null) missing.push("own colours");
  if (camera.falloff !== 0) missing.push("darker border");
  if (camera.lamp !== null) missing.push("flickering light");
  for (const [effect, text] of EFFECTS) {
    if (header.corrected.get(effect)?.includes(name) === true) missing.push(text);
  }
  return missing.length === 0 ? null : `${name} is shown without its ${missing.join(", ")} (O shows them)`;
}
