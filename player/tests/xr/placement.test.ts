/** Where a scene stands in the room of somebody with a headset, what eyes see of it, and what hands do with it. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { lookingAxes, type Pose } from "../../src/geometry/poses";
import { dot, length, minus, plus, times, unit, type Vector } from "../../src/geometry/vectors";
import { cameraOf } from "../../src/xr/eye";
import { Placement } from "../../src/xr/placement";

const UP: Vector = unit([0.1, -1, 0.2]);
const CENTRE: Vector = [3, 1, -2];
const POSE: Pose = { axes: lookingAxes(CENTRE, plus(CENTRE, [0.4, 0.1, 1]), UP), centre: CENTRE };
const HEAD: Vector = [0.2, 1.6, 0.1];

/** From the head to the room, by columns: turned to the left by some radians. */
function head(turn: number, [x, y, z]: Vector = HEAD): number[] {
  const [c, s] = [Math.cos(turn), Math.sin(turn)];
  return [c, 0, -s, 0, 0, 1, 0, 0, s, 0, c, 0, x, y, z, 1];
}

const placed = (turn = 0): Placement => new Placement(POSE, UP, 5, { at: HEAD, back: [Math.sin(turn), 0, Math.cos(turn)] });
const near = (a: Vector, b: Vector): void => {
  assert.ok(length(minus(a, b)) < 1e-9, `${String(a)} is not ${String(b)}`);
};

/** A projection of OpenGL for tangents left, right, down and up of the axis. */
function projection(left: number, right: number, down: number, up: number): number[] {
  return [2 / (right - left), 0, 0, 0, 0, 2 / (up - down), 0, 0, (right + left) / (right - left), (up + down) / (up - down), -1, -1, 0, 0, -0.2, 0];
}

for (const turn of [0, 0.7, -2.5]) {
  test(`whoever enters, turned by ${turn}, stands where the camera stood and looks level where it looked`, () => {
    const placement = placed(turn);
    near(placement.point(HEAD), CENTRE);
    const camera = cameraOf({ matrix: head(turn), projection: projection(-1, 1, -1, 1), width: 100, height: 80 }, placement);
    const [right, down, ahead] = camera.worldToCamera.map(([x, y, z]): Vector => [x, y, z]);
    near(down, times(UP, -1));
    assert.ok(Math.abs(dot(right, UP)) < 1e-9 && dot(ahead, POSE.axes[2]) > 0.98);
    assert.equal(placement.scale, 2);
    near(placement.point(plus(HEAD, [0, 1, 0])), plus(CENTRE, times(UP, 2)));
  });
}

test("an eye's projection is a pinhole with its principal point aside", () => {
  const camera = cameraOf({ matrix: head(0), projection: projection(-1.2, 0.8, -0.9, 1.1), width: 200, height: 100 }, placed());
  const seen = (right: number, up: number): number[] => {
    const point = placed().point(plus(HEAD, [right, up, -1]));
    const [x, y, z] = camera.worldToCamera.map(([a, b, c, d]) => dot([a, b, c], point) + d);
    return [(camera.fx * x) / z + camera.cx, (camera.fy * y) / z + camera.cy].map((value) => Math.round(1e6 * value) / 1e6 + 0);
  };
  assert.deepEqual(seen(-1.2, 1.1), [0, 0]);
  assert.deepEqual(seen(0.8, -0.9), [200, 100]);
});

test("a hand takes the scene along; what two hands hold stays in them, turned and scaled", () => {
  const placement = placed();
  const held = placement.point([0.3, 1, -0.5]);
  placement.drag({ before: [0.3, 1, -0.5], after: [0.5, 1.2, -0.4] });
  near(placement.point([0.5, 1.2, -0.4]), held);
  const [left, right] = [placement.point([-0.2, 1, -0.5]), placement.point([0.2, 1, -0.5])];
  placement.pinch({ before: [-0.2, 1, -0.5], after: [0, 1.1, -0.1] }, { before: [0.2, 1, -0.5], after: [0, 1.1, -0.9] });
  near(placement.point([0, 1.1, -0.1]), left);
  near(placement.point([0, 1.1, -0.9]), right);
  assert.ok(Math.abs(placement.scale - 1) < 1e-9, "twice as large in the room");
});
