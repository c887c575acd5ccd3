/** What is drawn first has the order of the camera that the scene is looked at with. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { Stage } from "../../src/element/stage";
import type { Renderer } from "../../src/draw/renderer";
import type { DrawOrder } from "../../src/messages";

function stageOf(asked: number[], drawn: number[]): Stage {
  let ordered = 0;
  const renderer = {
    busy: false,
    times: {},
    canvas: {},
    load: () => undefined,
    order: ({ serial }: DrawOrder) => {
      ordered = serial;
    },
    draw: () => {
      drawn.push(ordered);
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
