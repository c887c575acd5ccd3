/** Opus blocks decoded by the browser (WebCodecs). */
import { BLOCK, RATE } from "../container/sound";
import type { Run } from "./runs";

/** Samples of each channel of a run; silence where a block is none that the browser decodes. */
export async function decoded(run: Run, channels: number): Promise<Float32Array[]> {
  const samples = Array.from({ length: channels }, () => new Float32Array(BLOCK * run.blocks.length));
  const decoder = new AudioDecoder({
    output: (data) => {
      const start = Math.round(data.timestamp / 1e6 * RATE);
      samples.forEach((channel, index) => {
        const part = channel.subarray(start, start + data.numberOfFrames);
        if (part.length < data.numberOfFrames) return; // what a decoder adds
        data.copyTo(part, { planeIndex: Math.min(index, data.numberOfChannels - 1), format: "f32-planar" });
      });
      data.close();
    },
    error: () => undefined, // what is damaged is silence
  });
  try {
    decoder.configure({ codec: "opus", sampleRate: RATE, numberOfChannels: channels });
    run.blocks.forEach((data, index) => {
      decoder.decode(new EncodedAudioChunk({ type: "key", timestamp: (index * BLOCK * 1e6) / RATE, data }));
    });
    await decoder.flush();
  } catch {
    // A decoder that met what it does not know is closed.
  }
  if (decoder.state !== "closed") decoder.close();
  return samples;
}
