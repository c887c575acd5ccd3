/** From where a stream is looked at: what was asked for before it came, and what tells the page. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { Navigation } from "../../src/camera/navigation";
import { Viewpoint } from "../../src/element/viewpoint";
import type { View } from "../../src/player_api";
import type { StreamHeader } from "../../src/scene";

const camera = (name: string, x: number) => ({ name, width: 200, height: 150, fx: 160, fy: 160, cx: 100, cy: 75, near: 0, distortion: [], worldToCamera: [[1, 0, 0, -x], [0, 1, 0, 0], [0, 0, 1, 0]] });
const stream = { cameras: [camera("a", 0), camera("b", 1), camera("c", 2)], heldOut: ["a"], presentation: { firstView: null } } as unknown as StreamHeader;
const free: View = { pose: { centre: [5, 6, 7], axes: [[1, 0, 0], [0, 1, 0], [0, 0, 1]] }, lens: { width: 100, height: 100, fx: 50, fy: 50, cx: 50, cy: 50, near: 0 } };

function viewpoint() {
  const navigation = new Navigation();
  const told = { moved: 0, put: 0, asked: 0 };
  const held: { navigation: Navigation | null } = { navigation };
  const count = (name: keyof typeof told) => () => { told[name]++; };
  const of = new Viewpoint({ navigation: () => held.navigation, moved: count("moved"), put: count("put"), asked: count("asked") });
  return { of, navigation, told, held, open: (named: string | null = null, view: View | null = null) => { of.open(stream, navigation, named, view); } };
}

/** Of the camera that is looked through; null: a free view. */
const nameOf = (of: Viewpoint): string | null => of.camera?.name ?? null;

test("a stream begins with its first camera that was not held out, and nobody has asked for that", () => {
  const { of, told, open } = viewpoint();
  assert.equal(of.view, null);
  open();
  assert.equal(nameOf(of), "b");
  assert.deepEqual(told, { moved: 1, put: 1, asked: 0 });
});

test("a camera that was named comes before that, one that was asked for before both, and each for one stream", () => {
  const { of, open } = viewpoint();
  open("c");
  assert.equal(nameOf(of), "c");
  of.close();
  of.lookAt("a");
  open("c");
  assert.equal(nameOf(of), "a");
  of.close();
  open("nobody");
  assert.equal(nameOf(of), "b");
});

test("a view that was asked for before the stream came is the one it begins with, whether there are pictures or not", () => {
  for (const pictures of [true, false]) {
    const { of, navigation, held, open, told } = viewpoint();
    if (!pictures) held.navigation = null;
    of.lookFrom(free.pose, free.lens);
    assert.equal(told.moved, 0);
    held.navigation = navigation;
    open("c", { ...free, pose: { ...free.pose, centre: [0, 0, 0] } });
    assert.equal(of.camera, null);
    assert.deepEqual(of.view?.pose.centre, [5, 6, 7]);
    assert.equal(told.asked, 1);
  }
});

test("cameras are gone through one after the other, by name, by number, and back to the last", () => {
  const { of, told, open } = viewpoint();
  open();
  of.next(1);
  assert.equal(nameOf(of), "c");
  of.next(1);
  assert.equal(nameOf(of), "a");
  of.lookAt("b");
  assert.equal(nameOf(of), "b");
  of.lookAt("nobody");
  of.lookThrough(99);
  assert.equal(nameOf(of), "b");
  of.lookFrom(free.pose, free.lens);
  assert.equal(nameOf(of), null);
  of.back();
  assert.equal(nameOf(of), "b");
  assert.ok(told.asked >= 5);
  of.close();
  assert.deepEqual([of.camera, of.view], [null, null]);
});

test("whoever flies wants to see the scene from elsewhere", () => {
  const { of, told, open } = viewpoint();
  open();
  of.fly([0, 0, 1]);
  assert.ok(of.isFlying && of.isMoving);
  assert.equal(told.asked, 1);
  of.fly([0, 0, 0]);
  assert.ok(!of.isMoving);
});
