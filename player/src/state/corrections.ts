/** The corrections block at the start of every frame's payload (SPEC section 6). */

import type { Fields } from "../container/fields";
import type { CameraCorrection, StreamHeader } from "../scene";

type Writable = { -readonly [name in keyof CameraCorrection]: CameraCorrection[name] };

const NUMBERS: Readonly<Record<string, readonly (keyof CameraCorrection)[]>> = {
  exposure_drift: ["exposure"],
  white_balance_drift: ["red", "blue"],
  camera_shake: ["yaw", "pitch", "roll"],
  lamp_flicker: ["lampPhase", "lampAmplitude"],
};

const NONE: CameraCorrection = { exposure: 0, red: 0, blue: 0, yaw: 0, pitch: 0, roll: 0, lampPhase: 0, lampAmplitude: 0 };

/** By camera, what the block tells of it: numbers of the block alone, without those of the header. */
export function readCorrections(fields: Fields, header: StreamHeader): Map<string, CameraCorrection> {
  const corrections = new Map<string, Writable>();
  for (const [effect, cameras] of header.corrected) {
    for (const name of cameras) {
      const correction = corrections.get(name) ?? { ...NONE };
      for (const number of NUMBERS[effect]) correction[number] = fields.i16();
      corrections.set(name, correction);
    }
  }
  return corrections;
}
