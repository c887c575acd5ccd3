/** Which frame is due: by the clock, but never far from what the decoder has shown; ends, loops and ranges. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { Playback } from "../../src/element/playback";

const playback = (changed: Partial<Playback> = {}): Playback =>
  Object.assign(new Playback(), { playing: true, frameCount: 60, complete: true, fps: 30, ...changed });
const near = (found: number, wanted: number): void => {
  assert.ok(Math.abs(found - wanted) < 1e-6, `${found} for ${wanted}`);
};

test("time runs by the clock, at the speed that was asked for, and only while it plays", () => {
  const of = playback();
  of.advance(0.1, 0);
  near(of.position, 3);
  assert.equal(of.due, 3);
  of.rate = 0.5;
  of.advance(0.1, 3);
  near(of.position, 4.5);
  assert.equal(of.due, 4);
  of.playing = false;
  of.advance(0.1, 4);
  near(of.position, 4.5);
});

test("rounding does not show a frame too early or too late", () => {
  const of = playback({ fps: 10 });
  for (let step = 0; step < 3; step++) of.advance(0.1, of.due);
  assert.equal(of.due, 3); // .1 + .1 + .1 is not .3
  assert.equal(playback({ position: 2.99 }).due, 2);
});

test("speeds that nobody can play are refused", () => {
  const of = playback();
  for (const rate of [0, -1, 17, NaN]) assert.throws(() => (of.rate = rate), RangeError);
  of.rate = 16;
  assert.equal(of.rate, 16);
});

test("where decoding is quick, fifteen frames may be passed over, and no more", () => {
  const of = playback();
  of.note(1, 1);
  of.advance(1, 0);
  assert.equal(of.due, 15);
  of.advance(1, 0);
  assert.equal(of.due, 15);
});

test("where decoding is slow, frames are shown one by one, later than they are due", () => {
  const of = playback();
  of.note(30, 1);
  of.advance(1, 0);
  assert.equal(of.due, 1);
  of.advance(1, 1);
  assert.equal(of.due, 2);
});

test("what decoding costs is the mean of some frames, for each step: one slow frame among quick ones counts little", () => {
  const of = playback();
  of.note(10, 1);
  of.note(60, 1); // 20 ms are comfortable at 30 frames a second
  of.advance(1, 0);
  assert.equal(of.due, 15);
  const slow = playback();
  slow.note(30, 1);
  slow.note(20, 1); // 28 are not
  slow.advance(1, 0);
  assert.equal(slow.due, 1);
  const seek = playback();
  seek.note(300, 30);
  seek.note(300, 30);
  seek.advance(1, 0);
  assert.equal(seek.due, 15);
});

test("twice the speed leaves half the time to decode", () => {
  const of = playback({ position: 0 });
  of.rate = 2;
  of.note(20, 1);
  of.advance(1, 0);
  assert.equal(of.due, 1);
});

test("no frame before the end is left out for being late, nor in a loop", () => {
  const of = playback({ position: 57 });
  of.note(30, 1);
  of.advance(1, 57);
  assert.deepEqual([of.due, of.ended], [58, false]);
  const again = playback({ position: 18, range: [10, 20] });
  again.note(30, 1);
  again.advance(1, 18);
  assert.equal(again.due, 19);
  again.advance(0.05, 19);
  near(again.position, 10.999);
});

test("a position that was sought stays where the picture is elsewhere still", () => {
  const of = playback({ position: 40 });
  of.note(30, 1);
  of.advance(0.1, 5);
  near(of.position, 40);
});

test("at its end a stream stops, on its last frame", () => {
  const of = playback({ position: 59.5 });
  of.advance(0.1, 59);
  assert.deepEqual([of.playing, of.ended, of.due, of.position], [false, true, 59, 60]);
});

test("a stream ends with its last frame's time, to the moment", () => {
  const of = playback({ position: 59 });
  of.advance(1 / 30, 59);
  assert.deepEqual([of.position, of.ended], [60, true]);
});

test("before its end is known, the last frame stays, and playing goes on", () => {
  const of = playback({ position: 59.5, complete: false, loop: true });
  of.advance(0.5, 59);
  assert.deepEqual([of.playing, of.ended, of.due], [true, false, 59]);
  assert.equal(of.repeated, null);
  of.frameCount = 61;
  of.advance(0.001, 59);
  assert.equal(of.due, 60);
});

test("a loop goes on with what is beyond its end, so that sound and pictures stay together", () => {
  const of = playback({ position: 59.5, loop: true });
  assert.deepEqual(of.repeated, [0, 60]);
  of.advance(0.05, 59);
  near(of.position, 1);
  assert.ok(of.playing && !of.ended);
  const tiny = playback({ frameCount: 1, loop: true });
  tiny.advance(0.5, 0);
  assert.ok(tiny.position < 1 && tiny.playing);
});

test("a range is played again and again, up to the last frame where it ends behind it, and comes before a loop", () => {
  const of = playback({ position: 19.5, range: [10, 20], loop: true });
  of.advance(0.05, 19);
  near(of.position, 11);
  const longer = playback({ position: 59.5, range: [50, 90] });
  assert.deepEqual(longer.repeated, [50, 60]);
  longer.advance(0.05, 59);
  near(longer.position, 51);
  const growing = playback({ position: 59.5, range: [50, 90], complete: false });
  growing.advance(0.5, 59);
  assert.equal(growing.due, 59);
});

test("playing before a range leads into it, and behind it to its beginning", () => {
  const before = playback({ position: 2, range: [10, 20] });
  before.advance(0.1, 2);
  near(before.position, 5);
  const behind = playback({ position: 42, range: [10, 20] });
  behind.advance(0.1, 42);
  near(behind.position, 10);
});

test("a range that begins behind the last frame is none", () => {
  const of = playback({ position: 59.5, range: [60, 70] });
  of.advance(0.1, 59);
  assert.ok(of.ended);
});

test("nothing is due of a stream without frames", () => {
  const of = playback({ frameCount: 0 });
  of.advance(1, -1);
  assert.deepEqual([of.due, of.position, of.playing], [0, 0, true]);
});

test("no frame behind a range is due, however steps add up", () => {
  const playback = new Playback();
  Object.assign(playback, { playing: true, range: [5, 9], frameCount: 90, complete: true, fps: 30, position: 5 });
  const due = new Set<number>();
  for (let picture = 0; picture < 400; picture++) {
    playback.advance(0.01 * (1 + (picture % 7)), playback.due);
    due.add(playback.due);
  }
  assert.deepEqual([...due].sort(), [5, 6, 7, 8]);
});
