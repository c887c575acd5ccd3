/** How much of a stream is there, as <video> counts it. */
import type { Session } from "./session";

/** 0 nothing, 1 the header, 2 a frame, 3 the next one as well, 4 all that follow. */
export function readyState({ header, info, buffered, playback, waiting }: Pick<Session, "header" | "info" | "buffered" | "playback" | "waiting">): 0 | 1 | 2 | 3 | 4 {
  if (header === null) return 0;
  if (info === null) return 1;
  const { due, frameCount } = playback;
  const end = buffered.find(([from, to]) => from <= due && to > due)?.[1] ?? 0;
  if (end === frameCount) return 4;
  return waiting || end <= due + 1 ? 2 : 3;
}
