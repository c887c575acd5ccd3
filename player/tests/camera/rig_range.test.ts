/** Views that move by themselves, and that stay where the cameras of a rig have seen the scene from. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { Navigation } from "../../src/camera/navigation";
import { RigRange } from "../../src/camera/rig_range";
import { lookingAxes, type Pose } from "../../src/geometry/poses";
import { dot, length, minus, type Vector } from "../../src/geometry/vectors";

const UP: Vector = [0, -1, 0];
const DEGREE = Math.PI / 180;

/** Cameras on a circle of radius 2 about the origin, from one compass angle to another. */
function rig(from: number, to: number, count: number): Pose[] {
  return Array.from({ length: count }, (_, i) => at(from + ((to - from) * i) / (count - 1)));
}

function at(degrees: number, distance = 2): Pose {
  const centre: Vector = [distance * Math.sin(degrees * DEGREE), -0.4, -distance * Math.cos(degrees * DEGREE)];
  return { axes: lookingAxes(centre, [0, 0, 0], UP), centre };
}

function navigationOf(poses: readonly Pose[], start: Pose): Navigation {
  const navigation = new Navigation();
  Object.assign(navigation, { pose: start, up: UP, pivot: [0, 0, 0], size: 2, range: new RigRange(poses, [0, 0, 0], UP) });
  return navigation;
}

const compass = ({ centre }: Pose): number => Math.atan2(centre[0], -centre[2]) / DEGREE;

for (const [name, from] of [["before", -40], ["across the compass' end", 140]] as const) {
  test(`an arc of cameras ${name}: between them is inside, behind them, above and far away is not`, () => {
    const range = new RigRange(rig(from, from + 80, 9), [0, 0, 0], UP);
    assert.equal(range.allAround, false);
    assert.equal(range.outside(at(from + 40).centre), 0);
    assert.equal(range.outside(at(from - 10).centre), 0);
    assert.ok(range.outside(at(from - 20).centre) > 0);
    assert.ok(range.outside(at(from + 220).centre) > range.outside(at(from + 110).centre));
    assert.ok(range.outside([0, -2, 0]) > 0);
    assert.ok(range.outside(at(from + 40, 5).centre) > 0);
    assert.ok(range.outside(at(from + 40, 0.5).centre) > 0);
  });
}

test("cameras all around leave every side open", () => {
  const range = new RigRange(rig(0, 330, 12), [0, 0, 0], UP);
  assert.equal(range.allAround, true);
  for (let degrees = 0; degrees < 360; degrees += 15) assert.equal(range.outside(at(degrees).centre), 0);
});

test("with limits a hand that turns on and on stays before the scene, and comes back", () => {
  const navigation = navigationOf(rig(-40, 40, 9), at(0));
  navigation.limited = true;
  for (let i = 0; i < 300; i++) {
    navigation.orbit(0.05, 0);
    navigation.step(0.016);
  }
  assert.ok(Math.abs(compass(navigation.pose)) < 40 + 12.1 && Math.abs(compass(navigation.pose)) > 30, `${compass(navigation.pose)}`);
  const stopped = Math.abs(compass(navigation.pose));
  for (let i = 0; i < 20; i++) {
    navigation.orbit(-0.02, 0);
    navigation.step(0.016);
  }
  assert.ok(Math.abs(compass(navigation.pose)) < stopped - 5);
});

test("a view sways within the arc, level, at one distance, and stops where somebody takes it", () => {
  const navigation = navigationOf(rig(-30, 30, 7), at(0));
  navigation.sway(true);
  const angles = Array.from({ length: 480 }, () => {
    navigation.step(0.05);
    assert.ok(Math.abs(length(navigation.pose.centre) - length(at(0).centre)) < 1e-9);
    assert.ok(Math.abs(dot(navigation.pose.axes[0], UP)) < 1e-9);
    return compass(navigation.pose);
  });
  assert.ok(Math.max(...angles) > 12 && Math.max(...angles) < 30 && Math.min(...angles) < -12);
  navigation.orbit(0.01, 0);
  for (let i = 0; i < 60; i++) navigation.step(0.05);
  const { centre } = navigation.pose;
  navigation.step(1);
  assert.ok(length(minus(navigation.pose.centre, centre)) < 1e-9);
  assert.equal(navigation.isSwaying, false);
});

test("where cameras stand all around, it goes around; people who want calm are left alone", () => {
  const navigation = navigationOf(rig(0, 330, 12), at(0));
  navigation.sway(true);
  for (let i = 0; i < 240; i++) navigation.step(0.05);
  assert.ok(Math.abs(compass(navigation.pose)) > 170, "half a round in half the time");
  const calm = navigationOf(rig(0, 330, 12), at(0));
  calm.calm = true;
  calm.sway(true);
  assert.equal(calm.step(1), false);
});
