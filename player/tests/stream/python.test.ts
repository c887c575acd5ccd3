/** Streams of which tests/player/test_same_as_python.py has written down what the Python decoder shows. */

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { StreamError, createStream } from "../../src/stream/index";
import type { SceneStream } from "../../src/scene";
import { hashOf } from "../decoder/inOrder";

interface Shown {
  readonly floats: string;
  readonly damaged: boolean;
}

/** null for a frame for which there is nothing to show. */
interface Case {
  readonly error?: string;
  readonly frames?: readonly (Shown | null)[];
  /** The frames before the stream was damaged. */
  readonly intact?: readonly string[];
}

const FOLDER = process.env["DECOGS_SAME_AS_PYTHON"];
const CASES = FOLDER ? (JSON.parse(readFileSync(join(FOLDER, "expected.json"), "utf8")) as Record<string, Case>) : {};

for (const [name, { error, frames, intact }] of Object.entries(CASES)) {
  test(name, async () => {
    const bytes = new Uint8Array(readFileSync(join(FOLDER!, `${name}.dgs`)));
    if (frames === undefined) {
      await assert.rejects(opened(bytes), (raised) => raised instanceof StreamError && raised.reason === error);
      return;
    }
    const stream = await opened(bytes);
    // It may know of more: of a last frame whose packet header is intact.
    assert.ok(stream.frames.length >= frames.length, stream.notices.join(" "));
    const inOrder = [...stream.frames.keys()];
    for (const index of [...inOrder, ...inOrder.reverse()]) {
      await checkFrame(stream, index, index < frames.length ? frames[index] : { floats: "", damaged: true }, intact);
    }
  });
}

async function checkFrame(stream: SceneStream, index: number, expected: Shown | null, intact?: readonly string[]): Promise<void> {
  if (expected === null) {
    await assert.rejects(stream.frame(index), StreamError);
    return;
  }
  const frame = await stream.frame(index);
  const [floats, says] = [hashOf(frame), `frame ${index}: ${frame.damage}`];
  assert.equal(frame.frame, index);
  if (expected.damaged && frame.damage === null) {
    // What Python conceals may be shown, if it is right: it does so with the frames after a packet that comes twice.
    assert.equal(floats, intact?.[index], says);
    return;
  }
  assert.equal(frame.damage !== null, expected.damaged, says);
  if (expected.floats) assert.equal(floats, expected.floats, says);
}

async function opened(bytes: Uint8Array): Promise<SceneStream> {
  const stream = await createStream(bytes);
  await stream.prefetch(0);
  return stream;
}
