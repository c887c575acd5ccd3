/** A stream in layers, which tests/player/test_layers.py writes: which layer is shown, and when. */
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import type { FromWorker } from "../../src/messages";
import type { ByteSource, Span } from "../../src/stream/sources";
import { createStream } from "../../src/stream/index";
import { StreamWorker } from "../../src/worker/stream_worker";
import { hashOf } from "../decoder/inOrder";

interface Expected {
  /** Of each frame: with all layers, and the base alone. */
  readonly whole: readonly string[];
  readonly base: readonly string[];
  /** Where the first refinement of a segment's base begins. */
  readonly refinements: number;
  readonly end: number;
  readonly damaged: number;
}

const FOLDER = process.env["DECOGS_LAYERS"];
const EXPECTED = FOLDER ? (JSON.parse(readFileSync(join(FOLDER, "expected.json"), "utf8")) as Expected) : null;
const bytesOf = (name: string): Uint8Array<ArrayBuffer> => new Uint8Array(readFileSync(join(FOLDER!, name)));

/** Bytes of which only some have come, until they are read. */
class Arriving implements ByteSource {
  readonly name = "arriving";
  access: ByteSource["access"] = "ranges";
  /** What was read without being there. */
  readonly asked: Span[] = [];
  comes = true;
  held: Span[];
  constructor(
    private readonly bytes: Uint8Array,
    from: number,
    to: number,
  ) {
    this.held = [
      [0, from],
      [to, bytes.length],
    ];
  }
  get size(): number {
    return this.bytes.length;
  }
  get bytesRead(): number {
    return this.bytes.length;
  }
  read(offset: number, length: number): Promise<Uint8Array> {
    if (!this.held.some(([from, to]) => from <= offset && offset + length <= to)) {
      this.asked.push([offset, offset + length]);
      if (this.comes) this.held = [[0, this.bytes.length]];
    }
    return Promise.resolve(this.bytes.subarray(offset, offset + length));
  }
  prefetch(): Promise<void> {
    return Promise.resolve();
  }
  refresh(): Promise<boolean> {
    return Promise.resolve(false);
  }
  close(): void {
    // Nothing is held.
  }
}

if (EXPECTED !== null) {
  const { whole, base, refinements, end, damaged } = EXPECTED;

  test("all layers are shown, and within a budget the base, from the next frame on", async () => {
    const stream = await createStream(bytesOf("layered.dgs"));
    await stream.prefetch(0);
    const { layers } = stream.header;
    assert.equal(layers.length, 2);
    for (const [index, budget] of [{}, { gaussians: layers[1].gaussians - 1 }, { gaussians: layers[1].gaussians }, { bitsPerSecond: 1 }, {}].entries()) {
      stream.keepWithin(budget);
      const frame = await stream.frame(index);
      const isBase = index === 1 || index === 3;
      assert.equal(frame.layer, isBase ? 0 : 1);
      assert.equal(hashOf(frame), (isBase ? base : whole)[index]);
      assert.equal(frame.changedRows, null, "another layer is another scene, as is the first");
    }
    assert.notEqual((await stream.frame(5)).changedRows, null);
    stream.close();
  });

  test("the base is shown until what refines it has come, and that is read behind it", async () => {
    const source = new Arriving(bytesOf("layered.dgs"), refinements, end);
    source.comes = false;
    const stream = await createStream(source);
    await stream.prefetch(0);
    assert.deepEqual(source.asked, [[refinements, end]], "the base is there");
    assert.equal(hashOf(await stream.frame(0)), base[0]);
    assert.equal(hashOf(await stream.frame(1)), base[1]);
    source.comes = true;
    assert.equal(await stream.refine(1), true);
    const frame = await stream.frame(1);
    assert.equal(frame.layer, 1, "in the midst of a segment");
    assert.equal(hashOf(frame), whole[1]);
    assert.equal(hashOf(await stream.frame(2)), whole[2]);
    stream.close();
  });

  test("a refinement that is damaged costs no frame of the base", async () => {
    const stream = await createStream(bytesOf("damaged.dgs"));
    await stream.prefetch(0);
    for (const index of [...whole.keys(), ...[...whole.keys()].reverse()]) {
      const frame = await stream.frame(index);
      assert.equal(frame.damage, null);
      const isBase = index >= damaged;
      assert.equal(hashOf(frame), (isBase ? base : whole)[index], `frame ${index}`);
      assert.equal(frame.layer, isBase ? 0 : 1);
    }
    assert.match(stream.notices.join(" "), /checksum/);
    stream.close();
  });

  test("where only the whole file can be had, all its frames are found before anything plays", async () => {
    const source = new Arriving(bytesOf("layered.dgs"), 0, 0);
    source.access = "sequential";
    const stream = await createStream(source);
    await stream.prefetch(0);
    assert.equal(stream.frames.length, base.length);
    for (const index of base.keys()) assert.equal(hashOf(await stream.frame(index)), base[index], `frame ${index}`);
    stream.close();
  });

  test("a frame that stays in the picture is refined", async () => {
    const sent: FromWorker[] = [];
    const source = new Arriving(bytesOf("layered.dgs"), refinements, end);
    const worker = new StreamWorker(
      (_, options) => createStream(source, options),
      (message) => sent.push(message),
      () => Promise.reject(new Error("no kernel")),
    );
    worker.receive({ type: "open", source: "layered.dgs", follow: false, first: 0, sparing: true });
    await until(() => sent.filter(({ type }) => type === "frame").length === 2);
    const layers = sent.flatMap((message) => (message.type === "frame" ? [[message.request, message.info.layer]] : []));
    assert.deepEqual(layers, [
      [0, 0],
      [-1, 1],
    ]);
    worker.receive({ type: "close" });
  });
}

async function until(done: () => boolean): Promise<void> {
  for (let turn = 0; !done(); turn++) {
    assert.ok(turn < 200, "it takes too long");
    await new Promise((wake) => setTimeout(wake, 20));
  }
}
