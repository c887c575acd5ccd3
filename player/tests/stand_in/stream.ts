/** A scene stream over the raw file that dump.py writes: what the worker sees, without a decoder. */
import type { Gaussians, SceneFrame, SceneStream, StreamHeader } from "../../src/scene";

interface DumpedFrame {
  kind: SceneFrame["kind"];
  bytes: number;
  count: number;
  offsets: [number, number, number, number, number];
  changedRows: number[] | null;
  counts: [number, number, number];
}

export async function createStream(source: string): Promise<SceneStream> {
  const buffer = await (await fetch(source)).arrayBuffer();
  const length = new Uint32Array(buffer, 0, 1)[0];
  const text = new TextDecoder().decode(new Uint8Array(buffer, 4, length));
  const { header, frames } = JSON.parse(text) as { header: StreamHeader; frames: DumpedFrame[] };
  const channels = 3 * (header.shDegree + 1) ** 2;
  const floats = (frame: DumpedFrame, group: number, width: number) =>
    new Float32Array(buffer, 4 + length + frame.offsets[group], frame.count * width);
  let shown = -1;
  return {
    header,
    frames: frames.map(({ kind, bytes }) => ({ kind: kind ?? "skip", bytes })),
    complete: true,
    metrics: new Map(),
    bytesRead: buffer.byteLength,
    frame(index) {
      const of = frames[index];
      const gaussians: Gaussians = {
        count: of.count,
        means: floats(of, 0, 3),
        logScales: floats(of, 1, 3),
        quaternions: floats(of, 2, 4),
        opacityLogits: floats(of, 3, 1),
        sh: floats(of, 4, channels),
      };
      const follows = index === shown + 1 && of.changedRows !== null;
      shown = index;
      const [changed, added, removed] = of.counts;
      const changedRows = follows ? Uint32Array.from(of.changedRows!) : null;
      const { kind, bytes } = of;
      return Promise.resolve({ frame: index, kind, bytes, damage: null, gaussians, changedRows, changed, added, removed });
    },
    prefetch: () => Promise.resolve(),
    refresh: () => Promise.resolve(false),
    close: () => undefined,
  };
}
