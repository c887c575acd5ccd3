/** Which frames' bytes are there, of a source that has some of its bytes. */
import type { FrameTable } from "./frameTable";
import type { ByteSource, Span } from "./sources";

type Held = ByteSource["held"];

/** Frames whose bytes are all held, from one up to, not including, another; `held` undefined: the source has all bytes. */
export function heldFrames(table: FrameTable, held: Held): readonly Span[] {
  // What is lost need not be waited for.
  return framesWith(table.length, (frame) => table.offset(frame) < 0 || holds(held, table.offset(frame), table.entries[frame].bytes));
}

/** Of a stream in layers, frames for which all that refines them is held. */
export function refinedFrames(table: FrameTable, held: Held): readonly Span[] {
  return table.refinements.size === 0 ? [] : framesWith(table.length, (frame) => isRefined(table, held, frame));
}

/** Whether the refinement of a frame has come, or there is none to come. */
export function isRefined(table: FrameTable, held: Held, frame: number): boolean {
  const place = table.refinements.get(frame);
  return place === undefined ? table.entries[frame].kind === "skip" : holds(held, place.offset, place.bytes);
}

/** Whether a range is among what is held. */
export function holds(held: Held, offset: number, bytes: number): boolean {
  return held === undefined || held.some(([from, to]) => from <= offset && to >= offset + bytes);
}

function framesWith(count: number, isThere: (frame: number) => boolean): readonly Span[] {
  const spans: [number, number][] = [];
  for (let frame = 0; frame < count; frame++) {
    if (!isThere(frame)) continue;
    const last = spans.at(-1);
    if (last?.[1] === frame) last[1]++;
    else spans.push([frame, frame + 1]);
  }
  return spans;
}

/** What of the bytes that lead to a frame from its keyframe on is held, from 0 to 1. */
export function heldShare(table: FrameTable, held: Held, frame: number): number {
  const last = Math.min(frame, table.length - 1);
  const key = table.keyAt(last);
  if (held === undefined || key === null || table.offset(last) < 0) return 1;
  const [start, end] = [table.offset(key), table.offset(last) + table.entries[last].bytes];
  const bytes = held.reduce((sum, [from, to]) => sum + Math.max(0, Math.min(to, end) - Math.max(from, start)), 0);
  return bytes / (end - start);
}
