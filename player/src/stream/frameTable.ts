/** Where the frames of a stream lie, and which are lost. */

import { StreamError, refuse } from "../container/errors";
import type { FrameEntry, FrameKind } from "../scene";

/** What a stream may miss of its frames: a few bytes must not be able to claim hours of the same picture. */
const LOST_AT_MOST = 65_536;
const LOST_AT_LEAST = 1024;
const LOST_FOR_EACH = 64;

const LOST: FrameEntry = { kind: null, bytes: 0 };

/** Where the packet of a refinement lies. */
export interface Place {
  readonly offset: number;
  readonly bytes: number;
}

export class FrameTable {
  readonly entries: FrameEntry[] = [];
  /** Of the layer above the base, by frame, where an index tells. */
  refinements: ReadonlyMap<number, Place> = new Map();
  private readonly offsets: number[] = [];
  private readonly causes = new Map<number, StreamError>();
  private present = 0;

  add(kind: FrameKind, offset: number, bytes: number): void {
    this.entries.push({ kind, bytes });
    this.offsets.push(offset);
    this.present++;
  }

  /** Frames up to, not including, `end` are missing. Raises "too-large" when that are too many to conceal. */
  addLost(end: number, cause: StreamError): void {
    const lost = end - this.present;
    const limit = Math.min(LOST_AT_MOST, LOST_AT_LEAST + LOST_FOR_EACH * this.present);
    if (lost > limit) refuse("too-large", `${lost} frames are missing, above the limit of ${limit}`);
    while (this.entries.length < end) {
      this.causes.set(this.entries.length, cause);
      this.entries.push(LOST);
      this.offsets.push(-1);
    }
  }

  /** Takes the last frame back, whose packet turned out to be none. */
  removeLast(): void {
    this.entries.pop();
    this.offsets.pop();
    this.present--;
  }

  get length(): number {
    return this.entries.length;
  }

  offset(frame: number): number {
    return this.offsets[frame];
  }

  /** What is wrong where a lost frame should be. */
  cause(frame: number): StreamError {
    return this.causes.get(frame) ?? new StreamError("frame-order", `the packet of frame ${frame} is missing`);
  }

  /** Up to, not including, which frame a frame's segment goes, `most` at most. */
  segmentEnd(frame: number, most = this.length): number {
    let end = frame + 1;
    while (end < Math.min(most, this.length) && this.entries[end].kind !== "key") end++;
    return end;
  }

  /** The last keyframe at or before a frame; null when there is none. */
  keyAt(frame: number): number | null {
    for (let key = Math.min(frame, this.length - 1); key >= 0; key--) {
      if (this.entries[key].kind === "key") return key;
    }
    return null;
  }
}
