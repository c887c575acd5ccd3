/** What is heard, and when: of a stream of 25 frames a second whose samples are each the number of their frame. */
import { Decoders, FakeContext, FakePanner } from "./audio";
import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";
import type { SoundFrame, SoundTrack, StreamHeader } from "../../src/scene";
import { LateSound } from "../../src/sound/late";
import { Speaker } from "../../src/sound/speaker";

const FPS = 25;
const PLAIN: SoundTrack = { channels: 1, position: null };

/** Two blocks a frame, of the frame's number; the tracks of one frame are alike. */
const frameOf = (frame: number, tracks: number): SoundFrame => ({
  frame,
  packets: Array.from({ length: tracks }, (_, track) => ({ track, offset: 0, blocks: [0, 1].map(() => new Uint8Array([frame])) })),
});
const framesOf = (from: number, to: number, tracks = 1): SoundFrame[] =>
  Array.from({ length: Math.max(0, to - from) }, (_, index) => frameOf(from + index, tracks));
const settled = async (): Promise<void> => {
  for (let turns = 0; turns < 4; turns++) await new Promise((done) => setImmediate(done));
};

class Heard {
  readonly asked: (readonly [from: number, to: number, request: number])[] = [];
  readonly speaker: Speaker;
  readonly context: FakeContext;
  private answered = 0;

  constructor(private readonly tracks: readonly SoundTrack[] = [PLAIN], state: AudioContextState = "running") {
    this.speaker = new Speaker(tracks, FPS, (...asked) => this.asked.push(asked));
    this.context = FakeContext.made.at(-1)!;
    this.context.state = state;
  }

  /** Gives all that was asked for and not given yet. */
  async give(): Promise<void> {
    for (const [from, to, request] of this.asked.slice(this.answered)) void this.speaker.take(request, framesOf(from, to, this.tracks.length));
    this.answered = this.asked.length;
    await settled();
  }

  /** Plays on by pictures of 10 ms, which follow the sound, from a position in frames; what is heard at each, by number of its frame. */
  async play(pictures: number, position: number, { count = 250, rate = 1, repeated = null as readonly [number, number] | null } = {}): Promise<{ position: number; heard: number[]; shown: number[] }> {
    const [heard, shown]: [number[], number[]] = [[], []];
    for (let picture = 0; picture < pictures; picture++) {
      this.speaker.keep(position, count, rate, repeated);
      await this.give();
      this.context.currentTime += 0.01;
      position += (this.speaker.elapsed() ?? 0.01) * rate * FPS;
      if (repeated !== null && position >= repeated[1]) position -= repeated[1] - repeated[0];
      heard.push(this.context.heard(this.context.currentTime - this.context.outputLatency));
      shown.push(Math.floor(position + 1e-6));
    }
    return { position, heard, shown };
  }
}

beforeEach(() => {
  FakeContext.made = [];
  FakeContext.fails = false;
  FakePanner.made = [];
  Decoders.held = null;
});

test("sound begins with its first sample however late its first piece comes, and time with it", async () => {
  const { speaker, context, asked } = new Heard();
  speaker.keep(0, 100, 1, null);
  assert.ok(speaker.starting);
  assert.equal(speaker.elapsed(), null);
  context.currentTime = 0.3;
  await speaker.take(asked[0][2], framesOf(asked[0][0], asked[0][1]));
  assert.ok(!speaker.starting);
  const [{ when, offset }] = context.sources;
  assert.equal(offset, 0);
  assert.ok(when >= 0.34 && when < 0.36, `at ${when}`);
  assert.equal(speaker.elapsed(), 0);
  context.currentTime = when + 0.25;
  assert.ok(Math.abs(speaker.elapsed()! - 0.25) < 1e-9);
  context.currentTime += 0.05;
  assert.ok(Math.abs(speaker.elapsed()! - 0.05) < 1e-9);
});

test("what is heard is what is shown, piece after piece", async () => {
  const of = new Heard();
  const { heard, shown } = await of.play(300, 10);
  // The last 10 ms of a frame may be those of the next.
  assert.ok(heard.slice(8).every((frame, at) => Math.abs(frame - shown[at + 8]) <= 1), heard.join());
  assert.ok(shown.at(-1)! > 80);
  assert.ok(heard.slice(8).every((frame) => frame >= 10));
});

test("pieces meet to the sample, though the latency is measured anew", async () => {
  const of = new Heard();
  await of.play(40, 0);
  of.context.outputLatency = 0.02;
  await of.play(60, 0.4 * FPS);
  const ends = of.context.sources.map(({ when, samples }) => [when, when + samples.length / 48_000]);
  assert.ok(ends.length > 3);
  for (const [at, [when]] of ends.entries()) if (at > 0) assert.ok(Math.abs(when - ends[at - 1][1]) < 1e-9, `${when} behind ${ends[at - 1][1]}`);
});

test("what goes out is started earlier by the output's latency, from its first sample", async () => {
  const of = new Heard();
  of.context.outputLatency = 0.1;
  of.speaker.keep(0, 100, 1, null);
  await of.give();
  const [{ when, offset }] = of.context.sources;
  assert.equal(offset, 0);
  of.context.currentTime = when + 0.1;
  assert.ok(of.speaker.elapsed()! < 1e-9);
  of.context.currentTime += 0.04;
  assert.ok(Math.abs(of.speaker.elapsed()! - 0.04) < 1e-9);
});

test("through headphones that take long, sound begins once, and pictures wait until it is heard", async () => {
  const of = new Heard();
  of.context.outputLatency = 0.3;
  const { heard, shown } = await of.play(200, 10);
  assert.ok(of.context.sources.every(({ stopped }) => stopped === Infinity), "sound began anew");
  assert.ok(shown.slice(0, 30).every((frame) => frame === 10));
  assert.ok(heard.slice(40).every((frame, at) => Math.abs(frame - shown[at + 40]) <= 1), heard.join());
});

test("sound begins anew where it and the pictures are more than 60 ms apart, not before", async () => {
  for (const [apart, restarts] of [[0.055, false], [0.065, true], [-0.055, false], [-0.065, true]] as const) {
    const of = new Heard();
    const { position } = await of.play(50, 25);
    const before = of.asked.length;
    const { sources } = of.context;
    const started = sources.length;
    // Pictures are where sound was, or will be, so many seconds from now.
    of.speaker.keep(position + apart * FPS, 250, 1, null);
    await of.give();
    assert.equal(sources.slice(0, started).some(({ stopped }) => stopped < Infinity), restarts, `${apart}`);
    assert.equal(of.asked.length > before + 1, restarts, `${apart}`);
  }
});

test("pictures that did not wait are joined where they are", async () => {
  const of = new Heard();
  of.speaker.keep(0, 100, 1, null);
  of.context.currentTime = 0.7;
  of.speaker.keep(0.7 * FPS, 100, 1, null);
  assert.ok(!of.speaker.starting);
  assert.equal(of.speaker.elapsed(), 0);
  await of.give();
  of.context.currentTime = 0.72;
  assert.equal(of.context.heard(0.72), 18);
  assert.ok(Math.abs(of.speaker.elapsed()! - 0.02) < 1e-9);
});

test("a piece that comes late is heard from where it is by then, at any speed, and begins with the frame that is shown", async () => {
  for (const rate of [0.5, 1, 2]) {
    const of = new Heard();
    of.speaker.keep(10.5, 100, rate, null);
    assert.equal(of.asked[0][1] - 13, 10);
    of.context.currentTime = 0.2;
    of.speaker.keep(10.5 + 0.2 * FPS * rate, 100, rate, null);
    of.context.currentTime = 0.25;
    await of.give();
    for (const time of [0.26, 0.31, 0.4]) assert.equal(of.context.heard(time), Math.floor(10.5 + time * FPS * rate), `${rate} ${time}`);
  }
});

test("pieces of a place that was left are not heard, whether they come late or are decoded late", async () => {
  const of = new Heard();
  of.speaker.keep(0, 250, 1, null);
  const [from, to, request] = of.asked[0];
  of.speaker.rest();
  of.speaker.keep(100, 250, 1, null);
  await of.speaker.take(request, framesOf(from, to));
  assert.equal(of.context.sources.length, 0);
  let decode = (): void => undefined;
  Decoders.held = new Promise((done) => (decode = done));
  const [first, end, again] = of.asked.find(([first]) => first > 50)!;
  const taken = of.speaker.take(again, framesOf(first, end));
  await settled();
  of.speaker.rest();
  of.speaker.keep(200, 250, 1, null);
  decode();
  Decoders.held = null;
  await taken;
  assert.equal(of.context.sources.length, 0);
  // Nor is a piece played twice.
  const [, , newest] = of.asked.at(-1)!;
  await of.speaker.take(newest, framesOf(190, 215));
  await of.speaker.take(newest, framesOf(190, 215));
  assert.equal(of.context.sources.length, 1);
});

test("the first piece decides when sound begins, though the next one is decoded sooner; one that fails stops no other", async () => {
  const of = new Heard();
  of.speaker.keep(0, 250, 1, null);
  let decode = (): void => undefined;
  Decoders.held = new Promise((done) => (decode = done));
  const [first, second, third] = of.asked;
  const taken = of.speaker.take(first[2], framesOf(first[0], first[1]));
  await settled();
  Decoders.held = null;
  const next = of.speaker.take(second[2], framesOf(second[0], second[1]));
  await settled();
  assert.equal(of.context.sources.length, 0);
  of.context.currentTime = 0.4;
  decode();
  await taken;
  await next;
  assert.deepEqual(of.context.sources.map(({ offset }) => offset), [0, 0]);
  assert.ok(of.context.sources[0].when >= 0.4);
  const failing = mock.method(of.context, "createBuffer", () => {
    throw new RangeError("no memory");
  });
  await assert.rejects(of.speaker.take(third[2], framesOf(third[0], third[1])), /no memory/);
  failing.mock.restore();
  of.context.currentTime = 1;
  of.speaker.keep(0.5 * FPS, 250, 1, null);
  const [from, to, request] = of.asked.at(-1)!;
  await of.speaker.take(request, framesOf(from, to));
  assert.equal(of.context.sources.length, 3);
});

test("a second and a half is asked for ahead, each piece with what its decoder needs before it", async () => {
  const of = new Heard();
  of.speaker.keep(100, 250, 1, null);
  // 200 ms and a block are 5.5 frames; pieces are half a second.
  assert.deepEqual(of.asked.map(([from, to]) => [from, to]), [[94, 113], [107, 126], [120, 139]]);
  await of.give();
  of.speaker.keep(101, 250, 1, null);
  assert.equal(of.asked.length, 3);
  const quick = new Heard();
  quick.speaker.keep(0, 250, 2, null);
  assert.equal(quick.asked.at(-1)![1], 78, "three seconds of the stream at twice the speed");
  const start = new Heard();
  start.speaker.keep(0, 20, 1, null);
  assert.deepEqual(start.asked.map(([from, to]) => [from, to]), [[0, 13], [7, 20]]);
});

test("what is repeated is heard without a gap, pass after pass", async () => {
  const of = new Heard();
  const { heard, shown } = await of.play(400, 22, { repeated: [20, 50] });
  const wrong = heard.slice(8).filter((frame, at) => {
    const apart = Math.abs(frame - shown[at + 8]);
    return apart > 1 && apart < 29;
  });
  assert.deepEqual(wrong, []);
  assert.ok(of.context.sources.every(({ stopped }) => stopped === Infinity), "sound began anew");
  // Every sample of the loop: nothing of a pass is left out.
  const began = of.context.sources[0].when;
  for (let at = 0; at < 90; at++) assert.equal(of.context.heard(began + (at + 0.5) / FPS), 20 + ((at + 2) % 30), `${at}`);
});

test("a loop that is given up, or another one, is not heard on", async () => {
  const of = new Heard();
  const { position } = await of.play(60, 30, { repeated: [20, 50] });
  assert.ok(of.asked.some(([from, to]) => from < 20 && to > 20), "the next pass was asked for");
  const { heard, shown } = await of.play(120, position);
  assert.ok(heard.slice(8).every((frame, at) => Math.abs(frame - shown[at + 8]) <= 1), heard.join());
  const early = new Heard();
  const { position: then } = await early.play(10, 0);
  await early.play(10, then, { repeated: [0, 200] });
  assert.ok(early.context.sources.every(({ stopped }) => stopped === Infinity), "nothing of it was asked for yet");
  const whole = new Heard();
  const { position: after } = await whole.play(3, 0, { repeated: [0, 39] });
  assert.equal(whole.asked.at(-1)![1], 39);
  await whole.play(10, after);
  assert.ok(whole.context.sources.every(({ stopped }) => stopped === Infinity), "what was asked for is the pass that is played");
  const other = new Heard();
  const { position: middle } = await other.play(10, 0);
  await other.play(300, middle, { repeated: [0, 50] });
  assert.ok(other.context.sources.every(({ stopped }) => stopped === Infinity), "it was taken up before its end");
});

test("at another speed sound begins anew, and at one that nobody understands it is silent", async () => {
  const of = new Heard();
  const { position } = await of.play(20, 0);
  const { heard, shown } = await of.play(100, position, { rate: 2 });
  assert.ok(heard.slice(8).every((frame, at) => Math.abs(frame - shown[at + 8]) <= 1), heard.join());
  assert.equal(of.context.sources.at(-1)!.rate, 2);
  for (const rate of [0.2, 4.5]) {
    of.speaker.keep(100, 250, rate, null);
    assert.ok(!of.speaker.starting);
    assert.equal(of.speaker.elapsed(), null);
    assert.equal(of.context.heard(of.context.currentTime + 0.1), 0);
  }
  for (const rate of [0.25, 4]) {
    of.speaker.keep(100, 250, rate, null);
    assert.ok(of.speaker.starting);
  }
});

test("rest is silence", async () => {
  const of = new Heard();
  await of.play(30, 0);
  of.speaker.rest();
  assert.equal(of.context.heard(of.context.currentTime), 0);
  assert.equal(of.speaker.elapsed(), null);
});

test("a piece that has ended is not stopped once more", async () => {
  const of = new Heard();
  await of.play(10, 0);
  const [first, second] = of.context.sources;
  first.end();
  of.speaker.rest();
  assert.equal(first.stopped, Infinity);
  assert.ok(second.stopped < Infinity);
});

test("all tracks of a piece begin together", async () => {
  const of = new Heard([PLAIN, { channels: 2, position: null }, PLAIN]);
  of.speaker.keep(5, 100, 1, null);
  const [from, to, request] = of.asked[0];
  await of.speaker.take(request, framesOf(from, to, 3));
  const { sources, currentTime } = of.context;
  assert.deepEqual(sources.map(({ when, offset }) => [when, offset]), Array.from({ length: 3 }, () => [sources[0].when, 0]));
  assert.ok(sources[0].when >= currentTime);
});

test("where a track has nothing, time goes on without it", async () => {
  const of = new Heard();
  of.speaker.keep(0, 100, 1, null);
  await of.speaker.take(of.asked[0][2], []);
  assert.equal(of.context.sources.length, 0);
  of.context.currentTime = 0.5;
  assert.ok(of.speaker.elapsed()! > 0.4);
  const live = new Heard();
  live.speaker.keep(99.5, 99, 1, null);
  assert.ok(!live.speaker.starting, "nothing is known of the newest frame, and nothing is waited for");
});

test("a context that may not sound yet is silent; whether it is about to is said by the browser", async () => {
  const of = new Heard([PLAIN], "suspended");
  of.speaker.keep(0, 100, 1, null);
  assert.deepEqual(of.asked, []);
  assert.ok(of.speaker.starting, "somebody has touched the page");
  const { userActivation } = navigator as unknown as { userActivation: { hasBeenActive: boolean } };
  userActivation.hasBeenActive = false;
  assert.ok(!of.speaker.starting);
  userActivation.hasBeenActive = true;
  of.context.onResume = () => Promise.reject(new DOMException("nobody touched it", "NotAllowedError"));
  of.speaker.begin();
  await settled();
  assert.ok(!of.speaker.starting);
  of.context.onResume = () => new Promise(() => undefined);
  document.dispatchEvent(new Event("pointerdown"));
  assert.equal(of.context.resumed, 2);
  assert.ok(of.speaker.starting, "it was touched again");
});

test("a closed speaker gives everything back", async () => {
  const of = new Heard();
  await of.play(30, 0);
  of.speaker.close();
  assert.equal(of.context.state, "closed");
  assert.equal(of.context.heard(of.context.currentTime), 0);
  document.dispatchEvent(new Event("keydown"));
  assert.equal(of.context.resumed, 0);
});

test("a track with a place is as loud as it was recorded from where it is to be, and the ears are where the picture is seen from", () => {
  const { speaker, context } = new Heard([PLAIN, { channels: 1, position: [3, 4, 0] }]);
  speaker.hearFrom([0, 0, 0]);
  assert.equal(FakePanner.made.length, 1);
  assert.equal(FakePanner.made[0].refDistance, 5);
  speaker.hearFrom([3, 4, 0]);
  assert.equal(FakePanner.made[0].refDistance, 1e-6, "browsers take no distance of nothing");
  assert.equal(FakePanner.made[0].options.positionX, 3);
  speaker.listen({ centre: [1, 2, 3], axes: [[1, 0, 0], [0, 1, 0], [0, 0, 1]] });
  const value = (name: string): number => context.listener[name].value;
  assert.deepEqual(["positionX", "positionY", "positionZ", "forwardZ", "upY"].map(value), [1, 2, 3, 1, -1]);
});

test("each track goes through its own place, with its own samples", async () => {
  const of = new Heard([PLAIN, { channels: 1, position: [1, 0, 0] }, { channels: 1, position: [0, 2, 0] }]);
  of.speaker.hearFrom([0, 0, 0]);
  assert.deepEqual(FakePanner.made.map(({ refDistance }) => refDistance), [1, 2]);
  of.speaker.keep(0, 100, 1, null);
  const [from, to, request] = of.asked[0];
  await of.speaker.take(request, framesOf(from, to).map(({ frame, packets }) => ({ frame, packets: [{ ...packets[0], track: 2 }] })));
  assert.deepEqual(of.context.sources.map(({ node }) => node), [FakePanner.made[1]]);
});

test("without leave to sound, pictures do not wait", async () => {
  const { sound } = late();
  await settled();
  FakeContext.made[0].state = "suspended";
  const { userActivation } = navigator as unknown as { userActivation: { hasBeenActive: boolean } };
  assert.equal(sound.elapsed(), 0);
  userActivation.hasBeenActive = false;
  assert.equal(sound.elapsed(), null);
  userActivation.hasBeenActive = true;
});

/** Sound of a stream, with the clock of the page in hand. */
function late(changed: Partial<StreamHeader> = {}) {
  const said: string[] = [];
  const sent: unknown[] = [];
  const clock = { now: 0 };
  mock.method(performance, "now", () => clock.now);
  const sound = new LateSound((message) => sent.push(message), (text) => said.push(text));
  const camera = { worldToCamera: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]] };
  const open = (): void => {
    sound.open({ sound: [PLAIN], fps: FPS, cameras: [camera], ...changed } as unknown as StreamHeader);
  };
  open();
  return { sound, said, sent, clock, open };
}
const place = { position: 0, frameCount: 100, rate: 1, complete: true, repeated: null };

test("a context that cannot be made is said, and pictures play without sound", async () => {
  const refused: unknown[] = [];
  const note = (error: unknown): unknown => refused.push(error);
  process.on("unhandledRejection", note);
  FakeContext.fails = true;
  const { sound, said } = late();
  await settled();
  process.off("unhandledRejection", note);
  assert.deepEqual(refused, []);
  assert.deepEqual(said, ["the stream's sound cannot be played: there is no sound card"]);
  sound.begin();
  assert.equal(sound.elapsed(), null);
  assert.equal(sound.audible, false);
});

test("pictures wait for sound that is about to begin, half a second at most, and not again in vain", async () => {
  const { sound, clock, sent } = late();
  assert.equal(sound.elapsed(), 0, "its script is on its way");
  await settled();
  sound.keep(place);
  clock.now = 499;
  assert.equal(sound.elapsed(), 0);
  sound.rest();
  sound.keep(place);
  clock.now = 900;
  assert.equal(sound.elapsed(), 0, "that is another beginning");
  clock.now = 1401;
  assert.equal(sound.elapsed(), null);
  sound.rest();
  sound.keep(place);
  assert.equal(sound.elapsed(), null);
  const { request, from, to } = sent.at(-1) as { request: number; from: number; to: number };
  const first = sent.filter((each) => (each as { from: number }).from === 0).at(-1) as { request: number };
  assert.ok(first.request <= request && to > from);
  sound.receive({ type: "sound", request: first.request, frames: framesOf(0, 13) });
  await settled();
  assert.equal(sound.elapsed(), 0, "it is put on the clock");
  sound.rest();
  sound.keep(place);
  assert.equal(sound.elapsed(), 0, "it is waited for again");
});

test("who plays before the script has come is heard", async () => {
  const { sound } = late();
  sound.begin();
  sound.volume = 0.5;
  await settled();
  const [context] = FakeContext.made;
  assert.equal(context.resumed, 1);
  assert.equal(context.gain.gain.value, 0.5);
  assert.ok(sound.audible);
  sound.volume = 0.25;
  assert.equal(context.gain.gain.value, 0.25);
  sound.volume = 0.5;
  sound.muted = true;
  assert.equal(context.gain.gain.value, 0);
  assert.ok(!sound.audible);
  assert.equal(sound.volume, 0.5);
  assert.throws(() => (sound.volume = 1.5), RangeError);
});

test("a stream that is closed before the script has come makes no sound", async () => {
  const { sound } = late();
  sound.close();
  await settled();
  assert.deepEqual(FakeContext.made, []);
  assert.equal(sound.elapsed(), null);
});

test("who has played one stream, or has waited for it, has not played the next", async () => {
  const { sound, open, clock } = late();
  sound.begin();
  assert.equal(sound.elapsed(), 0);
  await settled();
  sound.close();
  assert.equal(FakeContext.made[0].state, "closed");
  open();
  clock.now = 600;
  assert.equal(sound.elapsed(), 0);
  await settled();
  assert.equal(FakeContext.made.length, 2);
  assert.equal(FakeContext.made[1].resumed, 0);
});

test("of a stream that grows, the last frame's sound is not asked for", async () => {
  const { sound, sent } = late();
  await settled();
  sound.keep({ ...place, frameCount: 10, complete: false });
  assert.equal((sent.at(-1) as { to: number }).to, 9);
  sound.rest();
  sound.keep({ ...place, frameCount: 10 });
  assert.equal((sent.at(-1) as { to: number }).to, 10);
});

test("a stream without sound, and a browser that plays none", () => {
  const none = late({ sound: [] });
  assert.equal(none.sound.elapsed(), null);
  const { AudioDecoder } = globalThis;
  Reflect.deleteProperty(globalThis, "AudioDecoder");
  const { said } = late();
  globalThis.AudioDecoder = AudioDecoder;
  assert.deepEqual(said, ["this browser does not play the stream's sound"]);
});
