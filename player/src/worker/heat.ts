/** When each Gaussian last changed, as a byte a row that the page colours: see `HEAT` in messages.ts. */
import { HEAT, TEXTURE_WIDTH, textureLines } from "../messages";
import type { SceneFrame } from "../scene";
import type { Buffers } from "./buffers";

/** Frames after which a change no longer glows. */
const FADE_FRAMES = 12;

export class Heat {
  private lastChanged = new Int32Array(0);
  private known: Int32Array = this.lastChanged;
  private frame = 0;
  private base = 0;

  /** Notes what a frame changed; whether anything still glows, or did in the frame before. */
  take(frame: SceneFrame, rows: Uint32Array | null, before: number): boolean {
    const moved = frame.frame !== this.frame;
    this.frame = frame.frame;
    if (frame.kind === "key") this.base = frame.frame;
    if (frame.gaussians.lastChanged !== undefined) {
      this.known = frame.gaussians.lastChanged;
      return moved;
    }
    // Without the decoder's own note: from the changed rows, as long as rows stay where they are.
    const { count } = frame.gaussians;
    if (this.lastChanged.length < count) {
      const longer = new Int32Array(Math.ceil(count * 1.25));
      longer.set(this.lastChanged);
      this.lastChanged = longer;
    }
    this.known = this.lastChanged;
    if (rows === null) {
      this.base = frame.frame;
      this.lastChanged.fill(frame.frame, 0, count);
    } else {
      for (const row of rows) this.lastChanged[row] = frame.frame;
      this.lastChanged.fill(frame.frame, before, count);
    }
    return moved;
  }

  bytes(count: number, buffers: Buffers): Uint8Array {
    const bytes = buffers.bytes(TEXTURE_WIDTH * textureLines(count, 1));
    const { known, frame, base } = this;
    for (let row = 0; row < count; row++) {
      const last = known[row];
      bytes[row] = last <= base || last > frame ? HEAT.still : heatOfAge(frame - last);
    }
    return bytes;
  }
}

function heatOfAge(age: number): number {
  return age >= FADE_FRAMES ? HEAT.earlier : Math.max(HEAT.oldest, Math.round(HEAT.now * (1 - age / FADE_FRAMES)));
}
