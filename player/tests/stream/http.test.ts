/** Streams from a server: what is read of them, and that every way of reading gives the same frames. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { DEFAULT_LIMITS } from "../../src/container/limits";
import type { SceneStream } from "../../src/scene";
import { CACHE_SIZES, CachedSource } from "../../src/stream/cache";
import { HttpFeed } from "../../src/stream/http";
import { StreamError, createStream } from "../../src/stream/index";
import { EXPECTED, vector } from "../decoder/vectors";
import { hashOf } from "../decoder/inOrder";
import { measured, packetsOf, padded } from "./packets";
import { serve, type Manner } from "./server";

const NAME = "good/keys-that-refer";
const { frames } = EXPECTED[NAME];
/** 300 kB behind each packet: 3.6 MB. */
const LARGE = padded(vector(NAME), 300_000);

async function withServer(
  manner: Manner,
  work: (address: string, requests: string[]) => Promise<void>,
  file: () => Uint8Array = () => LARGE,
): Promise<void> {
  const served = await serve(file, manner);
  try {
    await work(served.address, served.requests);
  } finally {
    await served.stop();
  }
}

async function checkFrames(stream: SceneStream, order: Iterable<number> = frames.keys()): Promise<void> {
  for (const index of order) {
    assert.equal(hashOf(await stream.frame(index)), frames[index].floats, `frame ${index}`);
  }
}

test("the first picture needs header and first keyframe, and the index comes beside it", async () => {
  await withServer({}, async (address, requests) => {
    const stream = await createStream(address);
    await checkFrames(stream, [0]);
    assert.ok(stream.bytesRead <= CACHE_SIZES.opening + 2 * CACHE_SIZES.block, `${stream.bytesRead} bytes`);
    assert.equal(requests[0], `bytes=0-${CACHE_SIZES.opening - 1}`);
    stream.close();
  });
});

test("figures of frames are known as soon as their bytes were read ahead", async () => {
  for (const manner of [{}, { ranges: false }]) {
    await withServer(
      manner,
      async (address) => {
        const stream = await createStream(address);
        await stream.frame(0);
        await stream.prefetch(1);
        const told = [...stream.metrics].sort(([a], [b]) => a - b);
        assert.deepEqual(told, frames.map((_, frame) => [frame, { psnr: 30 + frame }]));
        stream.close();
      },
      () => measured(vector(NAME)),
    );
  }
});

test("seeking reads the end, the index, the first keyframe and one segment", async () => {
  await withServer({}, async (address) => {
    const stream = await createStream(address);
    await checkFrames(stream, [10]);
    assert.equal(stream.frames.length, frames.length);
    assert.equal(stream.complete, true);
    const key = packetsOf(LARGE).filter(({ kind }) => kind === 2).at(-1)!;
    const segment = 10 - key.frame + 1;
    assert.ok(stream.bytesRead < CACHE_SIZES.opening + (segment * 6 + 4) * CACHE_SIZES.block, `${stream.bytesRead} bytes`);
    stream.close();
  });
});

const MANNERS: Record<string, Manner> = {
  "with ranges": {},
  "without ranges": { ranges: false },
  "without ranges, of unknown length": { ranges: false, tellsLength: false },
  "that answers only when it is asked again": { fails: twice() },
};

/** Each range fails twice, in two ways; what is left of one that was cut is the same range. */
function twice(): NonNullable<Manner["fails"]> {
  const asked = new Map<string | undefined, number>();
  return ({ headers }) => {
    const range = headers.range?.split("-")[1];
    const count = asked.get(range) ?? 0;
    asked.set(range, count + 1);
    return ([503, "cut"] as const)[count] ?? null;
  };
}

for (const [name, manner] of Object.entries(MANNERS)) {
  test(`a server ${name}: all frames, in order, read ahead, and backwards`, async () => {
    await withServer(manner, async (address) => {
      const stream = await createStream(new CachedSource(new HttpFeed(address, false, [1, 1])));
      await checkFrames(stream);
      await stream.prefetch(0);
      await checkFrames(stream, [...frames.keys()].reverse());
      assert.equal(stream.frames.length, frames.length);
      assert.deepEqual(stream.notices, []);
      stream.close();
    });
  });
}

test("memory is bounded: blocks that were read long ago go", async () => {
  for (const ranges of [true, false]) {
    await withServer({ ranges }, async (address) => {
      const source = new CachedSource(new HttpFeed(address, false), { ...CACHE_SIZES, block: 4096, opening: 8192, kept: 65_536 });
      const stream = await createStream(source);
      for (const index of frames.keys()) {
        await checkFrames(stream, [index]);
        assert.ok(source.bytesKept <= 65_536, `${source.bytesKept} bytes`);
      }
      await checkFrames(stream, [0, 5]);
      stream.close();
    });
  }
});

test("a growing file: frames come as they are whole, up to the end packet", async () => {
  for (const ranges of [true, false]) {
    const packets = packetsOf(LARGE);
    let size = packets[2].offset + 5;
    let version = 0;
    const manner: Manner = { ranges, version: () => String(version++) };
    await withServer(
      manner,
      async (address) => {
        const stream = await createStream(address, { follow: true });
        assert.equal(await stream.refresh(), false);
        await checkFrames(stream, [0]);
        assert.equal(stream.complete, false);
        await assert.rejects(stream.frame(1), /not in this stream of 1 frames/);
        for (const next of packets.slice(3)) {
          size = next.offset + 5;
          assert.equal(await stream.refresh(), true);
          const whole = packets.filter(({ kind, offset, bytes }) => kind >= 2 && kind <= 4 && offset + bytes.length <= size);
          assert.equal(stream.frames.length, whole.length);
          await checkFrames(stream, [whole.length - 1]);
        }
        size = LARGE.length;
        assert.equal(await stream.refresh(), true);
        assert.equal(stream.complete, true);
        assert.equal(await stream.refresh(), false);
        assert.deepEqual(stream.notices, []);
        stream.close();
      },
      () => LARGE.subarray(0, size),
    );
  }
});

test("a cut stream shows what is there and says that it is cut", async () => {
  const packets = packetsOf(LARGE);
  const cut = packets.find(({ kind, frame }) => kind >= 2 && kind <= 4 && frame === 6)!;
  await withServer(
    {},
    async (address) => {
      const stream = await createStream(address);
      await checkFrames(stream, [0, 3, 5]);
      await assert.rejects(stream.frame(6), /not in this stream of 6 frames/);
      assert.equal(stream.complete, false);
      assert.match(stream.notices.join(), /cut off/);
      stream.close();
    },
    () => LARGE.subarray(0, cut.offset + 100),
  );
});

test("what the server says is told", async () => {
  await withServer({ fails: () => 404 }, async (address, requests) => {
    await assert.rejects(createStream(address), (error) => error instanceof StreamError && /404/.test(error.message));
    assert.equal(requests.length, 1);
  });
  await assert.rejects(createStream("http://127.0.0.1:9/none.dgs"), StreamError);
});

test("a file that is replaced while it is read is not mixed with the old one", async () => {
  let version = "a";
  await withServer({ version: () => version }, async (address) => {
    const stream = await createStream(address);
    await stream.frame(0);
    version = "b";
    await assert.rejects(stream.frame(7), /changed on the server/);
    stream.close();
  });
});

test("a frame that is not wanted any more is given up, and the next one comes all the same", async () => {
  await withServer({}, async (address) => {
    const stream = await createStream(address);
    const controller = new AbortController();
    const given = stream.frame(8, controller.signal);
    controller.abort();
    await assert.rejects(given, { name: "AbortError" });
    await checkFrames(stream, [8, 2]);
    stream.close();
    await assert.rejects(stream.frame(3), StreamError);
  });
});

test("reading ahead goes on where the one before was", async () => {
  await withServer({}, async (address, requests) => {
    const stream = await createStream(address);
    await stream.frame(0);
    await Promise.all([stream.prefetch(0), stream.prefetch(1), stream.prefetch(2)]);
    const before = requests.length;
    await checkFrames(stream);
    assert.equal(requests.length, before);
    assert.ok(stream.bytesRead < LARGE.length + 4 * CACHE_SIZES.request, `${stream.bytesRead} bytes`);
    stream.close();
  });
});

test("a file that the user chose", async () => {
  const stream = await createStream(new Blob([LARGE as BlobPart]));
  await checkFrames(stream, [10, 0, 5]);
  assert.equal(await stream.refresh(), false);
});

test("limits of the reader", async () => {
  const limits = { gaussians: 1 };
  assert.ok(DEFAULT_LIMITS.gaussians > 1);
  const stream = await createStream(vector(NAME), { limits });
  await assert.rejects(stream.frame(0), { reason: "too-many-gaussians" });
});
