/** Regions drawn over a picture, and the commands that they become. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { cropCommand, drawnRegion, outlines, type Region } from "../../src/controls/region";
import type { PinholeCamera } from "../../src/geometry/camera";

const LENS = { width: 200, height: 100, fx: 100, fy: 100, cx: 100, cy: 50, near: 0 };
/** Along z, and along -x: from beside. */
const FRONT: PinholeCamera = { ...LENS, worldToCamera: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]] };
const BESIDE: PinholeCamera = { ...LENS, worldToCamera: [[0, 0, 1, -2], [0, 1, 0, 0], [-1, 0, 0, 2]] };
const AROUND = [0, 0, 2] as const;

test("a sphere lies about the first point, as far away as the rig looks", () => {
  const sphere = drawnRegion("sphere", FRONT, AROUND, [100, 50], [125, 50], null);
  assert.deepEqual(sphere, { kind: "sphere", centre: [0, 0, 2], radius: 0.5 });
  assert.equal(cropCommand(sphere, "scene.dgs"), "decogs-edit scene.dgs -o cropped.dgs crop sphere 0,0,2 0.5");
});

test("a box is as deep as it is wide, until it is drawn from beside", () => {
  const first = drawnRegion("box", FRONT, AROUND, [75, 40], [125, 65], null);
  assert.deepEqual(first, { kind: "box", low: [-0.5, -0.2, 1.5], high: [0.5, 0.3, 2.5] });
  const second = drawnRegion("box", BESIDE, AROUND, [90, 40], [150, 65], first);
  const { low, high } = second as Extract<Region, { kind: "box" }>;
  const close = (found: readonly number[], expected: readonly number[]): void => {
    found.forEach((value, i) => { assert.ok(Math.abs(value - expected[i]) < 1e-12, found.join()); });
  };
  close(low, [-0.5, -0.2, 1.8]);
  close(high, [0.5, 0.3, 3]);
  assert.equal(cropCommand(second, "it's mine.dgs"), String.raw`decogs-edit 'it'\''s mine.dgs' -o cropped.dgs crop box -0.5,-0.2,1.8 0.5,0.3,3`);
});

test("edges that lie behind the camera are left out", () => {
  const box: Region = { kind: "box", low: [-1, -1, -1], high: [1, 1, 1] };
  const lines = outlines(box, FRONT);
  assert.equal(lines.length, 12);
  assert.equal(lines.filter((line) => line.length === 2).length, 4);
  assert.equal(lines.filter((line) => line.length === 0).length, 4);
});
