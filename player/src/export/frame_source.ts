/**
 * A stream as SuperSplat and the PlayCanvas engine take sequences: a number of frames, any of them, and an end.
 *
 * A frame is what the engine's `new GSplatData(elements)` takes: one element "vertex" with the properties of a .ply of
 * 3D Gaussians. Values are the stored ones, as decogs-export writes them into .ply with `--up none`.
 */

import type { Gaussians } from "./scene";
import { createStream, type StreamOptions, type StreamSource } from "./stream/index";

export interface SplatProperty {
  readonly name: string;
  readonly type: "float";
  readonly storage: Float32Array;
  readonly byteSize: 4;
}

export interface SplatElement {
  readonly name: "vertex";
  readonly count: number;
  readonly properties: SplatProperty[];
}

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
  for (let known = -1; !stream.complete && stream.frames.length > known; ) {
    known = stream.frames.length;
    await stream.prefetch(Math.max(known - 1, 0));
  }
  const coefficients = (stream.header.shDegree + 1) ** 2;
  return {
    frameCount: stream.frames.length,
    async getFrame(index) {
      // Frames come one after the other, and the decoder's arrays hold this one until what follows here has run.
      return splatElement((await stream.frame(index)).gaussians, coefficients);
    },
    destroy() {
      stream.close();
    },
  };
}

function splatElement(gaussians: Gaussians, coefficients: number): [SplatElement] {
  const { count, order, means, logScales, quaternions, opacityLogits, sh } = gaussians;
  const properties: SplatProperty[] = [];
  const add = (names: readonly string[], values: Float32Array, width: number, first = 0, step = 1): void => {
    names.forEach((name, n) => {
      const storage = new Float32Array(count);
      const channel = first + n * step;
      for (let row = 0; row < count; row++) storage[row] = values[width * (order === null ? row : order[row]) + channel];
      properties.push({ name, type: "float", storage, byteSize: 4 });
    });
  };
  const width = 3 * coefficients;
  const rest = coefficients - 1;
  add(["x", "y", "z"], means, 3);
  add(numbered("f_dc", 3), sh, width);
  // In .ply all coefficients of red come first, then green's, then blue's.
  const names = numbered("f_rest", 3 * rest);
  for (let colour = 0; colour < 3; colour++) {
    add(names.slice(colour * rest, (colour + 1) * rest), sh, width, 3 + colour, 3);
  }
  add(["opacity"], opacityLogits, 1);
  add(numbered("scale", 3), logScales, 3);
  add(numbered("rot", 4), quaternions, 4);
  return [{ name: "vertex", count, properties }];
}

function numbered(name: string, count: number): string[] {
  return Array.from({ length: count }, (_, n) => `${name}_${n}`);
}
