/** Time: which frame is due. As with a video, time runs on by the clock, but it waits for a decoder that cannot keep up. */

import type { Span } from "../player_api";

/** Frames a second where a stream does not say. */
export const DEFAULT_FPS = 30;
/** Frames that may be passed over at once to keep up when drawing, not decoding, is slow. */
const MOST_SKIPPED = 15;
/** Share of real time that decoding may take before frames are shown one by one, later than they are due. */
const COMFORTABLE = 0.8;

/** A moment of a stream, whose frames a second may not be known yet. */
export type Moment = { readonly seconds: number } | { readonly frame: number };

/** In frames and parts of them. */
export function framesOf(moment: Moment, fps: number): number {
  return "frame" in moment ? moment.frame : moment.seconds * fps;
}

/** Of a frame: sums of steps miss whole frames by less. */
const ROUNDING = 1e-6;

export class Playback {
  playing = false;
  loop = false;
  /** Frames that are played again and again, from one up to, not including, another; null: all are played. */
  range: Span | null = null;
  ended = false;
  /** In frames; its whole part is the frame that is due. */
  position = 0;
  fps = DEFAULT_FPS;
  frameCount = 0;
  /** Whether no more frames will come. */
  complete = false;
  private costMs = 0;
  private speed = 1;

  get rate(): number {
    return this.speed;
  }
  set rate(value: number) {
    if (!(value > 0 && value <= 16)) throw new RangeError("playbackRate must be above 0 and at most 16");
    this.speed = value;
  }

  get due(): number {
    return Math.max(0, Math.min(Math.floor(this.position + ROUNDING), this.frameCount - 1));
  }

  /** The frames that are played again and again, as far as they are known; null: none are. */
  get repeated(): Span | null {
    const { range, frameCount, complete } = this;
    if (range !== null && range[0] < frameCount) return [range[0], complete ? Math.min(range[1], frameCount) : range[1]];
    return this.loop && complete && frameCount > 0 ? [0, frameCount] : null;
  }

  /** Goes on by some seconds from a picture that shows frame `shown`. */
  advance(seconds: number, shown: number): void {
    if (!this.playing || this.frameCount === 0) return;
    const most = shown + this.allowed() + 1 - 1e-3;
    const next = Math.min(this.position + seconds * this.rate * this.fps, Math.max(most, this.position));
    const { repeated } = this;
    if (repeated !== null && next >= repeated[1] - ROUNDING) {
      const [from, to] = repeated;
      // What is beyond the end belongs to the next pass, since sound goes on without a gap. Elsewhere a range begins anew.
      this.position = this.position < to ? from + ((next - to) % (to - from)) : from;
      return;
    }
    this.position = next;
    if (this.position < this.frameCount) return;
    if (!this.complete) {
      this.position = this.frameCount - 1e-3; // what comes next is not there yet
    } else {
      this.position = this.frameCount;
      this.playing = false;
      this.ended = true;
    }
  }

  /** Notes what a frame cost: decoding, packing and sorting, of so many steps. */
  note(milliseconds: number, steps: number): void {
    const cost = milliseconds / Math.max(1, steps);
    this.costMs = this.costMs === 0 ? cost : 0.8 * this.costMs + 0.2 * cost;
  }

  private allowed(): number {
    return (this.costMs * this.fps * this.rate) / 1000 < COMFORTABLE ? MOST_SKIPPED : 1;
  }
}
