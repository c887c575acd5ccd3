/** Frames as .ply are those of decogs-export: tests/player/test_ply.py has written streams and their frame 2 as decogs-export has it. */
import assert from "node:assert/strict";
import { readFileSync, readdirSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { plyOf } from "../../src/export/ply";
import { createStream } from "../../src/stream/index";

const END = "end_header\n";
/** Of float32, in sums of seven products of harmonics below 2. */
const ROUNDED = 2e-6;
const FOLDER = process.env["DECOGS_PLY"];

for (const name of FOLDER ? readdirSync(FOLDER).filter((each) => each.endsWith(".dgs")) : []) {
  test(name, async () => {
    const stream = await createStream(new Uint8Array(readFileSync(join(FOLDER!, name))));
    const { gaussians } = await stream.frame(2);
    const found = Buffer.from(plyOf(gaussians, stream.header));
    const expected = readFileSync(join(FOLDER!, name.replace(".dgs", ".ply")));
    const end = expected.indexOf(END) + END.length;
    assert.equal(found.subarray(0, end).toString(), expected.subarray(0, end).toString());
    assert.equal(found.length, expected.length);
    const tolerance = stream.header.presentation.transform === null ? 0 : ROUNDED;
    for (let at = end; at < found.length; at += 4) {
      const [a, b] = [found.readFloatLE(at), expected.readFloatLE(at)];
      assert.ok(Math.abs(a - b) <= tolerance * Math.max(1, Math.abs(b)), `${a} and ${b} at ${at}`);
    }
  });
}
