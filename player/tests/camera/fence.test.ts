/** Views that stay where a map says that the scene holds. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { Fence } from "../../src/camera/fence";
import { Navigation } from "../../src/camera/navigation";
import { RigRange } from "../../src/camera/rig_range";
import { lookingAxes, type Pose } from "../../src/geometry/poses";
import type { Vector } from "../../src/geometry/vectors";

const UP: Vector = [0, -1, 0];

/** A plan of x and z, from -3 to 3 in both: the lower half of the left column and the whole middle column are admitted. */
const MAP = {
  axes: [[1, 0, 0], [0, 0, 1]],
  low: [-3, -3],
  high: [3, 3],
  psnr: [[30, 29, null], [20, 28, 12.5]],
  within: [[true, true, false], [false, true, false]],
};

function from(x: number, z: number): Pose {
  const centre: Vector = [x, -0.4, z];
  return { axes: lookingAxes(centre, [0, 0, 0], UP), centre };
}

test("inside are admitted cells, and outside is as far as it is to the nearest", () => {
  const fence = Fence.of(MAP);
  for (const [x, z] of [[-2, -2], [0, -2], [0, 2], [0.99, 2.99]]) assert.equal(fence.outside([x, 7, z]), 0);
  assert.equal(fence.outside([-2, 0, 2]), 1);
  assert.equal(fence.outside([4, 0, 7]), 5);
});

test("nobody walks out of the fence, nor above it, and whoever is outside may come back", () => {
  const navigation = new Navigation();
  const rig = [-60, -20, 20, 60].map((degrees) => from(2 * Math.sin((degrees * Math.PI) / 180), -2 * Math.cos((degrees * Math.PI) / 180)));
  Object.assign(navigation, { pose: from(0, -2), up: UP, pivot: [0, 0, 0], size: 2, range: new RigRange(rig, [0, 0, 0], UP), limited: true, fence: Fence.of(MAP) });
  const turn = (right: number, down: number, times: number): Vector => {
    for (let i = 0; i < times; i++) {
      navigation.orbit(right, down);
      navigation.step(0.016);
    }
    return navigation.pose.centre;
  };
  const heldAt = turn(0.02, 0, 300);
  assert.ok(Math.abs(heldAt[0]) <= 3 && Fence.of(MAP).outside(heldAt) === 0);
  const other = turn(-0.02, 0, 300);
  assert.ok(Fence.of(MAP).outside(other) === 0 && Math.abs(other[0] - heldAt[0]) > 1, "the other side is reached");
  assert.ok(turn(0, 0.02, 200)[1] > -1.2, "not above all cameras");
  navigation.goTo(from(1.8, 1.8), navigation.lens, true);
  const before = Fence.of(MAP).outside(navigation.pose.centre);
  const [left, right] = [0.02, -0.02].map((step) => {
    navigation.goTo(from(1.8, 1.8), navigation.lens, true);
    return Fence.of(MAP).outside(turn(step, 0, 20));
  });
  assert.ok(Math.max(left, right) <= before && Math.min(left, right) < before - 0.3);
});

const OTHERS: [string, unknown][] = [
  ["nothing", null],
  ["another document", { cells: [] }],
  ["rows of two lengths", { ...MAP, within: [[true], [true, false]] }],
  ["no cells", { ...MAP, within: [] }],
  ["cells that are no truth values", { ...MAP, within: [[1, 0]] }],
  ["three axes", { ...MAP, axes: [...MAP.axes, [0, 1, 0]] }],
  ["corners without numbers", { ...MAP, low: ["a", "b"] }],
  ["too many cells", { ...MAP, within: Array.from({ length: 300 }, () => Array.from({ length: 300 }, () => true)) }],
];
for (const [name, document] of OTHERS) test(`no fence: ${name}`, () => { assert.throws(() => Fence.of(document), /decogs-report --fence writes/); });

test("a fence that admits no place is none", () => {
  assert.throws(() => Fence.of({ ...MAP, within: [[false]] }), /admits no place/);
});
