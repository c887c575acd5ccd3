/** A stream's world against its scene; that pictures are those of decogs-decode is compared in the browser. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { intoScene, type Similarity } from "../../src/geometry/similarity";
import { inItsWorld } from "../../src/geometry/world";
import type { RigCamera, StreamHeader } from "../../src/scene";

test("a camera that went into the world and comes back into the scene is the same", () => {
  const transform: Similarity = { rotation: [[0, -1, 0], [1, 0, 0], [0, 0, 1]], scale: 2, shift: [1, 2, 3] };
  const camera = { worldToCamera: [[0.8, 0, -0.6, 4], [0, 1, 0, -5], [0.6, 0, 0.8, 6]], near: 0.5 } as unknown as RigCamera;
  const header = inItsWorld({ cameras: [camera], presentation: { transform }, sound: [{ channels: 1, position: [1, 2, 3] }, { channels: 2, position: null }] } as unknown as StreamHeader);
  const [there] = header.cameras;
  assert.deepEqual(header.sound.map(({ position }) => position), [[-3, 4, 9], null]);
  // (0, 1, 0) R^T is (-1, 0, 0); 2 times -5, minus its product with the shift.
  assert.deepEqual(there.worldToCamera[1], [-1, 0, 0, -10 + 1]);
  assert.equal(there.near, 1);
  const back = intoScene(there, transform);
  assert.equal(back.near, 0.5);
  back.worldToCamera.flat().forEach((value, i) => {
    assert.ok(Math.abs(value - camera.worldToCamera.flat()[i]) < 1e-12);
  });
});
