/**
 * A stream as SuperSplat and the PlayCanvas engine take sequences: a number of frames, any of them, and an end.
 *
 * A frame is what the engine's `new GSplatData(elements)` takes: one element "vertex" with the properties of a .ply of
 * 3D Gaussians, with the values that decogs-export writes into .ply with `--up none`.
 */

import { createStream, type StreamOptions, type StreamSource } from "../stream/index";
import { splatElement, type SplatElement } from "./elements";

export interface FrameSource {
  readonly frameCount: number;
  /** The Gaussians of a frame, in arrays of their own. Rejects with a StreamError, as for a frame that is damaged. */
  getFrame(index: number): Promise<[SplatElement]>;
  destroy(): void;
}

/** Opens a stream whose end is there, and finds all its frames. Rejects with a StreamError. */
export async function createFrameSource(source: StreamSource, options: StreamOptions = {}): Promise<FrameSource> {
  const stream = await createStream(source, options);
  // Without an index, frames are found by walking there; it ends where nothing more is found.
  for (let count = -1; !stream.complete && stream.frames.length > count; ) {
    count = stream.frames.length;
    await stream.prefetch(Math.max(count - 1, 0));
  }
  return {
    frameCount: stream.frames.length,
    async getFrame(index) {
      // Frames come one after the other, and the decoder's arrays hold this one until what follows here has run.
      return splatElement((await stream.frame(index)).gaussians, stream.header);
    },
    destroy() {
      stream.close();
    },
  };
}
