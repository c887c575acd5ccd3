/** What is drawn first has the order of the camera that the scene is looked at with. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { Stage } from "../../src/element/stage";
import type { Renderer } from "../../src/draw/renderer";
import type { DrawOrder } from "../../src/messages";

/** `cost`: milliseconds of a picture of so many pixels across. */
function stageOf(asked: number[], drawn: number[], cost: (width: number) => number = () => 1, widths: number[] = [], quickly: boolean[] = []): Stage {
  let ordered = 0;
  const times = { uploadMs: 0, drawMs: 0 };
  const renderer = {
    busy: false,
    times,
    canvas: {},
    load: () => undefined,
    order: ({ serial }: DrawOrder) => {
      ordered = serial;
    },
    draw: ({ width }: { readonly width: number }, _: string, quick: boolean) => {
      drawn.push(ordered);
      quickly.push(quick);
      widths.push(width);
      times.drawMs = cost(width);
    },
  } as unknown as Renderer;
  return new Stage(
    renderer,
    () => ({ width: 64, height: 48 }),
    (_, serial) => {
      asked.push(serial);
    },
  );
}

const order = (serial: number): DrawOrder => ({ order: new Uint32Array(1), count: 1, sortMs: 0, serial });

test("an order that was asked for before the scene had a camera is not drawn", () => {
  const asked: number[] = [];
  const drawn: number[] = [];
  const stage = stageOf(asked, drawn);
  stage.step(0, 0.01, false);
  stage.begin();
  assert.deepEqual(asked, [1, 2]);
  stage.load(null, order(1));
  stage.step(10, 0.01, false);
  assert.deepEqual(drawn, []);
  stage.order(order(2));
  stage.step(20, 0.01, false);
  assert.deepEqual(drawn, [2]);
});

/** Widths of the pictures while the scene moves for some time, at 64 pixels across when they are whole. */
function moving(cost: (width: number) => number): number[] {
  const widths: number[] = [];
  const stage = stageOf([], [], cost, widths);
  stage.begin();
  stage.load(null, order(1));
  for (let picture = 0; picture < 40; picture++) {
    stage.touch();
    stage.step(20 * picture, 0.02, true);
  }
  return widths;
}

test("pictures shrink where their pixels are what takes the time", () => {
  assert.ok(moving((width) => 200 * (width / 64) ** 2).at(-1)! < 40);
});

test("pictures stay whole where Gaussians take the time, since smaller ones would not come sooner", () => {
  const widths = moving(() => 200);
  assert.equal(widths.at(-1), 64);
  assert.ok(widths.filter((width) => width < 64).length <= 2);
});

test("where pictures are slow, they are drawn quickly while they move, and once more as they are to be when they rest", () => {
  const quickly: boolean[] = [];
  const stage = stageOf([], [], () => 200, [], quickly);
  stage.begin();
  stage.load(null, order(1));
  for (let picture = 0; picture < 4; picture++) {
    stage.touch();
    stage.step(20 * picture, 0.02, true);
  }
  assert.deepEqual(quickly, [false, true, true, true]);
  assert.ok(stage.pending);
  stage.step(1000, 0.02, false);
  assert.deepEqual(quickly.slice(4), [false]);
  assert.ok(!stage.pending);
});

test("one slow picture, as the first one is that waits for its shaders, makes no others coarse", () => {
  const quickly: boolean[] = [];
  const stage = stageOf([], [], () => (quickly.length === 1 ? 200 : 5), [], quickly);
  stage.begin();
  stage.load(null, order(1));
  for (let picture = 0; picture < 5; picture++) {
    stage.touch();
    stage.step(20 * picture, 0.02, true);
  }
  assert.deepEqual(quickly, [false, true, false, false, false]);
});

test("where they are fast, none is drawn quickly; at a lower quality all are", () => {
  const quickly: boolean[] = [];
  const stage = stageOf([], [], () => 20, [], quickly);
  stage.begin();
  stage.load(null, order(1));
  stage.step(0, 0.02, true);
  stage.quality = 0.5;
  stage.touch();
  stage.step(1000, 0.02, false);
  assert.deepEqual(quickly, [false, true]);
});

test("a picture to be saved is refused where nobody sorts or draws any more", async () => {
  const lost = new AbortController();
  const waiting = stageOf([], []).capture(10, 10, lost.signal);
  lost.abort(new Error("out of memory"));
  await assert.rejects(waiting, /out of memory/);
  const drawn: number[] = [];
  const stage = stageOf([], drawn);
  const gone = new AbortController();
  const order1 = order(1);
  stage.begin();
  stage.load(null, order1);
  Object.assign(stage.renderer, { settled: () => { gone.abort(new Error("it was drawing")); return Promise.resolve(); } });
  await assert.rejects(stage.capture(10, 10, gone.signal), /it was drawing/);
  assert.equal(drawn.length, 1);
});
