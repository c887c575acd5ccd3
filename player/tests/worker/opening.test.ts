/** How a stream is opened: what is read ahead, and with whose cookies. */
import assert from "node:assert/strict";
import { mock, test } from "node:test";
import type { FromWorker, Opening } from "../../src/messages";
import { createStream } from "../../src/stream/index";
import type { StreamOptions } from "../../src/stream/sceneStream";
import { StreamWorker } from "../../src/worker/stream_worker";
import { GOOD, vector } from "../decoder/vectors";

/** Opens a stream of some frames; how it was opened, and how often was read ahead after its first frame, and after the second. */
async function opened(how: Partial<Opening>): Promise<{ options: StreamOptions; first: number; second: number }> {
  let options: StreamOptions = {};
  let ahead = 0;
  const answers: FromWorker[] = [];
  const open = async (_: string, given: StreamOptions) => {
    options = given;
    const stream = await createStream(vector(GOOD.find((name) => name.startsWith("good/sound"))!));
    mock.method(stream, "prefetch", () => {
      ahead++;
      return Promise.resolve();
    });
    return stream;
  };
  const worker = new StreamWorker(open, (message) => answers.push(message), () => Promise.reject(new Error("no kernel")));
  const frames = async (count: number): Promise<void> => {
    while (answers.filter(({ type }) => type === "frame").length < count) await new Promise((done) => setImmediate(done));
  };
  worker.receive({ type: "open", source: "a.dgs", follow: false, first: 0, ...how });
  await frames(1);
  const first = ahead;
  worker.receive({ type: "show", frame: 1, request: 1 });
  await frames(2);
  worker.receive({ type: "close" });
  return { options, first, second: ahead };
}

test("what follows a frame is read ahead; of a stream whose first picture alone is wanted, when another one is asked for", async () => {
  const plain = await opened({});
  assert.deepEqual([plain.options.ahead, plain.first, plain.second], [true, 1, 2]);
  const sparing = await opened({ sparing: true });
  assert.deepEqual([sparing.options.ahead, sparing.first, sparing.second], [false, 0, 1]);
});

test("cookies go along where that was asked for", async () => {
  assert.equal((await opened({})).options.credentials, undefined);
  assert.equal((await opened({ credentials: "include" })).options.credentials, "include");
  const { fetch } = globalThis;
  const asked: (RequestCredentials | undefined)[] = [];
  globalThis.fetch = (_, init) => {
    asked.push(init?.credentials);
    return Promise.resolve(new Response(null, { status: 404 }));
  };
  await assert.rejects(createStream("http://localhost/a.dgs", { credentials: "include" }));
  await assert.rejects(createStream("http://localhost/a.dgs"));
  globalThis.fetch = fetch;
  assert.deepEqual([...new Set(asked)], ["include", "same-origin"]);
});
