/** Which frames' bytes are there, of a source that has some of its bytes. */
import type { FrameTable } from "./frameTable";
import type { Span } from "./sources";

/** Frames whose bytes are all held, from one up to, not including, another; `held` undefined: the source has all bytes. */
export function heldFrames(table: FrameTable, held: readonly Span[] | undefined): readonly Span[] {
  if (held === undefined) return table.length > 0 ? [[0, table.length]] : [];
  const spans: [number, number][] = [];
  for (let frame = 0, span = 0; frame < table.length; frame++) {
    const start = table.offset(frame);
    const end = start + table.entries[frame].bytes;
    while (span < held.length && held[span][1] < end) span++;
    // What is lost need not be waited for.
    if (start >= 0 && !(span < held.length && held[span][0] <= start)) continue;
    const last = spans.at(-1);
    if (last?.[1] === frame) last[1]++;
    else spans.push([frame, frame + 1]);
  }
  return spans;
}

/** What of the bytes that lead to a frame from its keyframe on is held, from 0 to 1. */
export function heldShare(table: FrameTable, held: readonly Span[] | undefined, frame: number): number {
  const last = Math.min(frame, table.length - 1);
  const key = table.keyAt(last);
  if (held === undefined || key === null || table.offset(last) < 0) return 1;
  const [start, end] = [table.offset(key), table.offset(last) + table.entries[last].bytes];
  const bytes = held.reduce((sum, [from, to]) => sum + Math.max(0, Math.min(to, end) - Math.max(from, start)), 0);
  return bytes / (end - start);
}
