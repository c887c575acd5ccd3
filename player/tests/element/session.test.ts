/** One stream's life: what is asked of the worker, when time runs, what events tell, and that no promise stays open. */
import { FakeWorker, frameTable, header, info, turn } from "./browser";
import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";
import type { FrameInfo, FromWorker } from "../../src/messages";
import { Session } from "../../src/element/session";
import type { Drawing } from "../../src/element/session_host";
import type { StreamHeader } from "../../src/scene";

interface Options {
  readonly frames?: number;
  readonly complete?: boolean;
  readonly follow?: boolean;
  readonly autoplay?: boolean;
  readonly of?: Partial<StreamHeader>;
}

class Opened {
  readonly events: string[] = [];
  readonly warnings: (string | null)[] = [];
  readonly loading: boolean[] = [];
  readonly busy: (readonly [boolean, number | null])[] = [];
  reopened = 0;
  wakes = 0;
  exactlyDrawn: unknown[] = [];
  /** What was drawn, in order. */
  readonly drawn: string[] = [];
  readonly session: Session;
  /** Whether WebGL2 takes the place of a kernel that does not draw. */
  webgl = false;
  readonly drawing: Drawing & { awaitsKernel: boolean; exact: boolean } = {
    begin: () => this.drawn.push("stream"),
    exactlyDrawn: ({ picture }) => {
      this.exactlyDrawn.push(picture);
      if (picture !== null) this.drawing.awaitsKernel = false;
      else if (this.webgl) this.drawing.exact = this.drawing.awaitsKernel = false;
    },
    awaitsKernel: false,
    exact: true,
    stage: { begin: () => this.drawn.push("begin"), load: () => this.drawn.push("load"), order: () => this.drawn.push("order") },
  };

  constructor(private readonly options: Options = {}) {
    this.session = new Session({
      tell: (name) => this.events.push(name),
      wake: () => this.wakes++,
      loading: (on) => this.loading.push(on),
      busy: (on, share) => this.busy.push([on, share]),
      reopen: () => {
        this.reopened++;
        this.open();
      },
      warn: (text) => this.warnings.push(text),
      opened: () => this.drawn.push("opened"),
      autoplay: () => options.autoplay === true,
    });
    this.open();
  }

  get worker(): FakeWorker {
    return FakeWorker.opened;
  }

  open(): void {
    this.session.close();
    this.session.open({ source: "http://localhost/a.dgs", follow: this.options.follow === true }, this.drawing);
  }

  /** The header comes. */
  begin(): this {
    const { frames = 90, complete = true, of = {} } = this.options;
    this.worker.say({ type: "opened", header: header(of), layout: { shDegree: 0, restTexels: 0 }, frames: frameTable(frames), complete });
    return this;
  }

  /** A frame comes: the one that was asked for last. */
  show(frame: number, request = this.worker.asked("show").at(-1)?.request ?? 0, changed: Partial<FrameInfo> = {}): this {
    const draw = { order: new Uint32Array(4), count: 1, sortMs: 0, serial: 1 };
    this.worker.say({ type: "frame", request, info: info(frame, changed), update: null, draw });
    return this;
  }

  progress(changed: Partial<Extract<FromWorker, { type: "progress" }>> = {}): this {
    const nothing = { bytesRead: 0, complete: true, frames: null, psnr: [], notices: [], trouble: null, buffered: [], refined: [], share: null };
    this.worker.say({ type: "progress", ...nothing, ...changed });
    return this;
  }

  /** Frames that were asked for, and answered as they come. */
  asked(): number[] {
    return this.worker.asked("show").map(({ frame }) => frame);
  }

  /** Plays on by so many pictures of a 30th of a second, each frame shown as soon as it is asked for. */
  run(pictures: number, seconds = 1 / 30): this {
    for (let picture = 0; picture < pictures; picture++) {
      const before = this.worker.asked("show").length;
      this.session.advance(seconds);
      if (this.worker.asked("show").length > before) this.show(this.asked().at(-1)!);
    }
    return this;
  }
}

const ready = (options: Options = {}): Opened => new Opened(options).begin().show(0);
/** What became of a promise by now. */
async function outcome(promise: Promise<unknown>): Promise<string> {
  const found = promise.then(
    () => "resolved",
    (error: unknown) => `${(error as Error).name}: ${(error as Error).message}`,
  );
  return Promise.race([found, turn().then(turn).then(() => "pending")]);
}

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setTimeout"] });
});

test("playing begins with the first picture, which the promise waits for", async () => {
  const of = new Opened();
  const played = of.session.play();
  assert.equal(await outcome(played), "pending");
  of.begin();
  assert.equal(await outcome(played), "pending");
  of.session.advance(1);
  assert.equal(of.session.position, 0);
  of.show(0);
  assert.equal(await outcome(played), "resolved");
  assert.deepEqual(of.events, ["loadstart", "play", "durationchange", "loadedmetadata", "loadeddata", "canplay", "playing", "timeupdate"]);
  of.run(4);
  assert.equal(of.session.playback.due, 3);
  assert.equal(await outcome(of.session.play()), "resolved");
  of.session.pause();
  void of.session.play();
  assert.deepEqual(of.events.slice(-3), ["pause", "play", "playing"]);
});

test("what had passed before playing began does not count: the first frame is seen, and heard", () => {
  const of = ready();
  void of.session.play();
  of.session.advance(0.1);
  assert.equal(of.session.position, 0);
  of.session.advance(0.1);
  assert.ok(Math.abs(of.session.position - 3) < 1e-9);
});

test("after a pause nothing of the pause counts", () => {
  const of = ready();
  void of.session.play();
  of.run(3);
  of.session.pause();
  const { position } = of.session;
  of.session.advance(5);
  void of.session.play();
  of.session.advance(5);
  assert.equal(of.session.position, position);
});

test("pictures go by the clock of the sound, where there is any", () => {
  const of = ready();
  void of.session.play();
  of.session.sound.elapsed = () => 0.1;
  of.session.advance(0.02);
  of.session.advance(0.02);
  assert.ok(Math.abs(of.session.position - 3) < 1e-9);
  of.session.sound.elapsed = () => null;
  of.session.advance(0.02);
  assert.ok(Math.abs(of.session.position - 3.6) < 1e-9);
});

test("sound is kept in step while pictures play, and rests in a pause, a seek and at the end", () => {
  const of = ready({ frames: 3 });
  const calls: string[] = [];
  of.session.sound.keep = ({ position, frameCount }) => calls.push(`${position.toFixed(1)} of ${frameCount}`);
  of.session.sound.rest = () => calls.push("rest");
  of.session.sound.begin = () => calls.push("begin");
  of.session.advance(0.02);
  void of.session.play();
  of.session.advance(0.02);
  of.session.advance(1 / 30);
  of.session.seek(2);
  of.session.advance(0.02);
  of.show(2);
  of.session.advance(0.02);
  of.session.advance(0.5);
  assert.deepEqual(calls, ["rest", "begin", "0.0 of 3", "1.0 of 3", "rest", "2.0 of 3", "rest"]);
  calls.length = 0;
  void of.session.play();
  of.session.pause();
  assert.deepEqual(calls, ["begin", "rest"], "silence does not wait for the next picture");
  of.session.sound.close = () => calls.push("close");
  of.session.close();
  assert.equal(calls.at(-1), "close");
});

test("a stream that ends pauses, tells it, and is played from its beginning again", () => {
  const of = ready({ frames: 3 });
  void of.session.play();
  of.run(6);
  assert.deepEqual([of.session.playback.ended, of.session.playback.due], [true, 2]);
  of.run(3);
  assert.deepEqual(of.events.slice(-2), ["pause", "ended"]);
  assert.equal(of.events.filter((name) => name === "ended").length, 1);
  void of.session.play();
  assert.deepEqual([of.session.position, of.asked().at(-1), of.session.playback.ended], [0, 0, false]);
});

test("playing from the last frame begins anew, one before it does not", () => {
  const of = ready({ frames: 3 });
  of.session.seek(1);
  of.show(1);
  void of.session.play();
  assert.equal(of.session.position, 1);
  of.session.pause();
  of.session.seek(2);
  of.show(2);
  void of.session.play();
  assert.equal(of.session.position, 0);
  const grows = ready({ frames: 3, complete: false });
  grows.session.seek(2);
  grows.show(2);
  void grows.session.play();
  assert.equal(grows.session.position, 2, "the last frame so far");
});

for (const [what, act, says] of [
  ["a pause", (of: Opened) => { of.session.pause(); }, "AbortError: playing was ended before it began"],
  ["another stream", (of: Opened) => { of.open(); }, "AbortError: another stream was opened, or the player has left the page"],
  ["an error", (of: Opened) => { of.worker.say({ type: "failed", request: null, message: "no stream" }); }, "NotSupportedError: no stream"],
  ["the worker's death", (of: Opened) => { of.worker.die(); }, "NotSupportedError: out of memory"],
] as const) {
  test(`${what} before the first picture refuses to play`, async () => {
    const of = new Opened().begin();
    const played = of.session.play();
    act(of);
    assert.equal(await outcome(played), says);
    assert.equal(of.session.playback.playing, false);
  });
}

test("who was told to play before there was a stream plays the first one", async () => {
  const of = new Opened();
  of.session.close();
  const played = of.session.play();
  of.open();
  of.begin().show(0);
  assert.equal(await outcome(played), "resolved");
  assert.equal(of.session.playback.playing, true);
});

test("a worker that dies answers nobody: all that it was asked for is refused, and what it is asked for then", async () => {
  const of = ready();
  const { session } = of;
  const asked = [session.ply(), session.still(0, {} as never), session.ply()];
  assert.ok(!session.lost.aborted);
  of.worker.die();
  for (const each of asked) assert.equal(await outcome(each), "Error: out of memory");
  assert.equal(await outcome(session.ply()), "Error: out of memory");
  assert.equal(await outcome(session.still(0, {} as never)), "Error: out of memory");
  assert.ok(session.lost.aborted);
  assert.deepEqual(of.exactlyDrawn, [null]);
  assert.ok(of.worker.terminated);
  assert.equal(session.error, "out of memory");
  assert.equal(of.events.at(-1), "error");
  const { length } = of.worker.sent;
  session.seek(5);
  assert.equal(of.worker.sent.length, length);
});

test("after its death, playing begins with another worker, where the picture was", async () => {
  const of = ready();
  void of.session.play();
  of.run(12);
  const dead = of.worker;
  dead.die();
  assert.equal(of.session.playback.playing, false);
  const played = of.session.play();
  assert.equal(of.reopened, 1);
  assert.notEqual(of.worker, dead);
  assert.equal(of.worker.asked("open")[0].first, 11);
  of.begin().show(11);
  assert.equal(await outcome(played), "resolved");
  assert.equal(of.session.playback.due, 11);
  assert.equal(of.session.error, null);
});

for (const [what, act] of [
  ["that was on its way ends with it", (of: Opened) => { of.session.seek(30); of.worker.die(); }],
  ["after it waits for nobody", (of: Opened) => { of.worker.die(); of.session.seek(30); }],
] as const) {
  test(`a seek ${what}, and playing begins there`, () => {
    const of = ready();
    act(of);
    assert.deepEqual([of.session.seeking, of.session.position], [false, 30]);
    void of.session.play();
    assert.equal(of.worker.asked("open")[0].first, 30);
  });
}

test("a closed stream refuses what was asked of it, and who asks it", async () => {
  const of = ready();
  const asked = [of.session.ply(), of.session.still(0, {} as never)];
  of.session.close();
  for (const each of asked) assert.match(await outcome(each), /^AbortError: another stream was opened/);
  assert.match(await outcome(of.session.ply()), /^AbortError/);
});

test("what the worker of a closed stream says still is not heard", () => {
  const of = ready();
  const { worker } = of;
  of.open();
  worker.die();
  worker.say({ type: "failed", request: null, message: "an old one" });
  assert.equal(of.session.error, null);
});

test("answers belong to the questions in their order", async () => {
  const of = ready();
  const [one, two, three] = [of.session.ply(), of.session.ply(), of.session.ply()];
  of.worker.say({ type: "ply", bytes: new Uint8Array([1]), problem: "" });
  of.worker.say({ type: "ply", bytes: null, problem: "no memory" });
  assert.deepEqual(await one, new Uint8Array([1]));
  assert.equal(await outcome(two), "Error: no memory");
  assert.equal(await outcome(three), "pending");
  const still = of.session.still(7, {} as never);
  assert.equal(of.worker.asked("still")[0].frame, 7);
  of.worker.say({ type: "still", picture: null });
  assert.equal(await still, null);
});

test("a seek is over when its frame is in the picture, not with one that was on its way", () => {
  const of = ready();
  of.session.seek(40);
  const first = of.worker.asked("show").at(-1)!.request;
  of.session.seek(20);
  assert.deepEqual(of.asked(), [40, 20]);
  of.show(40, first);
  assert.ok(of.session.seeking);
  assert.ok(!of.events.includes("seeked"));
  of.show(20);
  assert.ok(!of.session.seeking);
  assert.equal(of.events.at(-1), "seeked");
});

test("time stands still until what was sought is there, so that nothing of it is passed over", () => {
  const of = ready();
  void of.session.play();
  of.run(30);
  of.session.seek(10);
  for (let picture = 0; picture < 20; picture++) of.session.advance(1 / 30);
  assert.equal(of.session.position, 10);
  of.show(10);
  of.session.advance(1 / 30);
  assert.equal(of.session.position, 10);
  of.session.advance(1 / 30);
  assert.ok(Math.abs(of.session.position - 11) < 1e-9);
});

test("seeks stay within the stream, and what is no number goes nowhere", () => {
  const of = ready();
  of.session.seek(-5);
  assert.deepEqual([of.asked().at(-1), of.session.position], [0, 0]);
  of.session.seek(1000);
  assert.deepEqual([of.asked().at(-1), of.session.position], [89, 90]);
  const before = of.events.length;
  of.session.seek(NaN);
  assert.equal(of.events.length, before);
});

test("a frame that is not known yet is waited for, and gone to when it comes", () => {
  const of = ready({ frames: 10, complete: false });
  of.session.seek(20);
  assert.deepEqual([of.session.position, of.session.playback.position], [20, 9]);
  assert.equal(of.asked().at(-1), 9);
  of.show(9);
  assert.ok(!of.events.includes("seeked"));
  of.progress({ complete: false, frames: frameTable(21, 10) });
  assert.equal(of.asked().at(-1), 20);
  of.show(20);
  assert.ok(of.events.includes("seeked"));
  of.session.seek(21);
  assert.equal(of.session.position, 21, "the next one");
});

test("where the stream ends before it, the last frame is gone to", () => {
  const of = ready({ frames: 10, complete: false });
  of.session.seek(20);
  of.show(9);
  of.progress({ complete: true });
  of.show(9);
  assert.equal(of.session.playback.due, 9);
  assert.ok(!of.session.seeking);
});

test("a frame that does not come for 200 ms is told, and playing goes on with a second in store", () => {
  const of = ready();
  void of.session.play();
  of.session.advance(1 / 30);
  of.session.advance(1 / 30);
  mock.timers.tick(199);
  assert.ok(!of.events.includes("waiting"));
  mock.timers.tick(1);
  assert.ok(of.session.waiting);
  assert.equal(of.events.at(-1), "waiting");
  assert.deepEqual(of.busy.at(-1), [true, null]);
  of.session.advance(0.5);
  assert.equal(of.session.playback.due, 1);
  assert.ok(!of.session.seeking);
  of.show(1);
  assert.deepEqual(of.busy.at(-1), [true, null], "one frame is not enough");
  of.progress({ buffered: [[0, 30]] });
  of.session.advance(0.5);
  assert.ok(of.session.waiting, "frames 1 to 30 are a second");
  of.progress({ buffered: [[0, 31]] });
  of.session.advance(0.5);
  assert.ok(!of.session.waiting);
  assert.equal(of.events.at(-1), "playing");
  assert.equal(of.session.playback.due, 1);
});

test("at twice the speed, two seconds in store are a second; a pause waits for nothing", () => {
  const of = ready();
  of.session.playback.rate = 2;
  void of.session.play();
  of.session.advance(1 / 60);
  of.session.advance(1 / 60);
  mock.timers.tick(200);
  assert.ok(of.session.waiting);
  of.show(1);
  of.progress({ buffered: [[0, 60]] });
  of.session.advance(0.02);
  assert.ok(of.session.waiting);
  of.progress({ buffered: [[0, 61]] });
  of.session.advance(0.02);
  assert.ok(!of.session.waiting);
  assert.deepEqual(of.busy.at(-1), [false, null]);
  of.run(3);
  of.session.advance(1 / 30);
  mock.timers.tick(200);
  assert.ok(of.session.waiting);
  of.session.pause();
  assert.ok(!of.session.waiting);
});

test("what is to be drawn reaches the pictures in the order in which it comes, and something is to be done then", () => {
  const of = ready();
  assert.deepEqual(of.drawn, ["stream", "opened", "begin", "load"]);
  const draw = { order: new Uint32Array(8), count: 7, sortMs: 3, serial: 2 };
  let { wakes } = of;
  of.worker.say({ type: "order", draw });
  assert.equal(of.drawn.at(-1), "order");
  assert.deepEqual(of.session.drawn, { count: 7, sortMs: 3 });
  assert.equal(of.worker.asked("recycle").at(-1)?.buffers[0].byteLength, 32);
  assert.equal(of.wakes, wakes + 1);
  ({ wakes } = of);
  of.session.seek(3);
  assert.ok(of.wakes > wakes);
  ({ wakes } = of);
  void of.session.play();
  assert.ok(of.wakes > wakes);
  of.worker.say({ type: "exact", picture: null, problem: "there is no kernel", kernel: true });
  assert.deepEqual([of.exactlyDrawn, of.warnings.at(-1)], [[null], "there is no kernel"]);
  ({ wakes } = of);
  of.worker.die();
  assert.ok(of.wakes > wakes);
});

const exactly = (problem: string | null): Extract<FromWorker, { type: "exact" }> =>
  ({ type: "exact", picture: problem === null ? { width: 1, height: 1, pixels: new Uint8ClampedArray(4), drawMs: 1 } : null, problem, kernel: problem === null });

test("where the kernel draws, playing begins with its first picture", async () => {
  const of = ready();
  of.drawing.awaitsKernel = true;
  const played = of.session.play();
  of.show(0);
  assert.equal(await outcome(played), "pending");
  of.worker.say(exactly(null));
  assert.equal(await outcome(played), "resolved");
  assert.equal(of.events.filter((name) => name === "playing").length, 1);
});

test("where WebGL2 draws instead of the kernel, playing begins, and that is said until the kernel draws", async () => {
  const of = ready();
  of.drawing.awaitsKernel = of.webgl = true;
  const played = of.session.play();
  of.worker.say(exactly("it is missing"));
  assert.equal(await outcome(played), "resolved");
  assert.deepEqual([of.warnings.at(-1), of.session.error], ["WebGL2 draws: it is missing", null]);
  of.worker.say(exactly("it is missing still"));
  assert.equal(of.warnings.at(-1), "WebGL2 draws: it is missing", "nobody wants the kernel's any more");
  of.drawing.exact = true;
  of.worker.say(exactly(null));
  assert.equal(of.warnings.at(-1), null);
});

test("where neither draws, that is the error", async () => {
  const of = ready();
  of.drawing.awaitsKernel = true;
  const played = of.session.play();
  of.worker.say(exactly("it is missing"));
  assert.equal(await outcome(played), "NotSupportedError: it is missing");
  assert.equal(of.session.error, "it is missing");
});

test("where no worker can be started, that is the error", async () => {
  const { Worker } = globalThis;
  globalThis.Worker = function () { throw new Error("worker-src 'none'"); } as unknown as typeof Worker;
  try {
    const of = new Opened();
    of.open(); // one more than the worker that waits for the first stream
    assert.match(of.session.error!, /^the player's worker cannot be started: worker-src 'none'/);
    assert.match(await outcome(of.session.ply()), /worker cannot be started/);
  } finally {
    globalThis.Worker = Worker;
  }
});

test("the stream's sound is opened with it, and what the worker gives of it is played", () => {
  const of = new Opened();
  const calls: unknown[] = [];
  of.session.sound.open = ({ fps }) => calls.push(fps);
  of.session.sound.receive = ({ request }) => calls.push(request);
  of.begin();
  of.worker.say({ type: "sound", request: 9, frames: [] });
  assert.deepEqual(calls, [30, 9]);
});

test("a frame has come in time with another answer, or another frame with its own", () => {
  for (const [frame, request] of [[5, -1], [4, 1]] as const) {
    const of = ready();
    of.session.seek(5);
    mock.timers.tick(100);
    of.show(frame, request);
    of.busy.length = 0;
    mock.timers.tick(500);
    assert.deepEqual(of.busy, [], `${frame}`);
  }
});

test("near the end, all that is left is enough", () => {
  const of = ready({ frames: 20 });
  void of.session.play();
  of.run(10);
  of.session.advance(1 / 30);
  mock.timers.tick(200);
  assert.ok(of.session.waiting);
  of.progress({ buffered: [[0, 20]] });
  of.session.advance(0.02);
  assert.ok(of.session.waiting, "the frame itself has not come");
  of.show(of.session.playback.due);
  of.session.advance(0.02);
  assert.ok(!of.session.waiting);
});

test("a frame in time is never late, and nobody waits in a pause", () => {
  const of = ready();
  void of.session.play();
  of.session.advance(1 / 30);
  of.session.advance(1 / 30);
  mock.timers.tick(150);
  of.show(1);
  mock.timers.tick(500);
  assert.ok(!of.session.waiting);
  of.session.seek(20);
  mock.timers.tick(150);
  of.session.seek(40);
  mock.timers.tick(150);
  assert.ok(!of.session.waiting, "it was asked for 150 ms ago");
  of.show(40);
  of.session.pause();
  of.session.seek(50);
  mock.timers.tick(500);
  assert.ok(!of.session.waiting);
  assert.deepEqual(of.busy.at(-1), [true, null]);
});

test("the frame that stands for the stream is shown until somebody plays, who begins with the first", () => {
  const of = new Opened({ of: { presentation: { title: "", poster: 7, firstView: null, transform: null } } }).begin();
  of.session.advance(0);
  of.show(7);
  assert.deepEqual(of.worker.asked("show").map(({ frame, request }) => [frame, request]), [[7, 0]], "nobody has asked for it");
  assert.equal(of.session.position, 0);
  void of.session.play();
  assert.equal(of.worker.asked("show").at(-1)?.request, 1);
  assert.equal(of.asked().at(-1), 0);
  const sought = new Opened({ of: { presentation: { title: "", poster: 7, firstView: null, transform: null } } }).begin();
  sought.session.seek(3);
  sought.session.advance(0);
  assert.deepEqual(sought.asked(), [3]);
  const past = new Opened({ frames: 5, of: { presentation: { title: "", poster: 7, firstView: null, transform: null } } }).begin();
  past.session.advance(0);
  assert.deepEqual(past.asked(), [4]);
  const plays = new Opened({ autoplay: true, of: { presentation: { title: "", poster: 7, firstView: null, transform: null } } }).begin();
  plays.session.advance(0);
  assert.deepEqual(plays.asked(), []);
  assert.ok(plays.session.playback.playing);
});

test("a place that was set before the header came is where the stream begins", () => {
  const of = new Opened();
  of.session.close();
  of.session.start = { seconds: 2 };
  of.open();
  assert.equal(of.worker.asked("open")[0].first, null);
  assert.equal(of.session.position, 60);
  of.begin();
  assert.deepEqual(of.asked(), [60]);
  of.open();
  assert.equal(of.worker.asked("open")[0].first, 0, "it was for one stream");
  const frame = new Opened();
  frame.session.close();
  frame.session.start = { frame: 12 };
  frame.open();
  assert.equal(frame.worker.asked("open")[0].first, 12);
  assert.deepEqual(frame.session.start, { frame: 12 });
});

test("a first frame that is not there yet is asked for when it is", () => {
  const of = new Opened({ frames: 0, complete: false }).begin();
  of.worker.say({ type: "notYet" });
  of.session.advance(0);
  assert.deepEqual(of.asked(), []);
  of.progress({ complete: false, frames: frameTable(1) });
  of.session.advance(0);
  assert.deepEqual(of.asked(), [0]);
});

test("a file that grows is looked at every second, until it is whole", () => {
  const of = ready({ follow: true, complete: false });
  assert.equal(of.worker.asked("refresh").length, 0);
  mock.timers.tick(1000);
  assert.equal(of.worker.asked("refresh").length, 1);
  mock.timers.tick(5000);
  assert.equal(of.worker.asked("refresh").length, 1, "the answer is waited for");
  of.worker.say({ type: "refreshed", grown: false });
  of.worker.say({ type: "refreshed", grown: false });
  mock.timers.tick(1000);
  assert.equal(of.worker.asked("refresh").length, 2);
  of.progress({ complete: true });
  of.worker.say({ type: "refreshed", grown: true });
  mock.timers.tick(5000);
  assert.equal(of.worker.asked("refresh").length, 2);
  const other = ready({ complete: false });
  mock.timers.tick(5000);
  assert.equal(other.worker.asked("refresh").length, 0, "nobody asked to follow it");
  const left = ready({ follow: true, complete: false });
  left.open();
  mock.timers.tick(1000);
  assert.equal(left.worker.asked("refresh").length, 0, "another stream is open");
});

test("another layer is told, and no first one", () => {
  const of = ready();
  const told = (): number => of.events.filter((name) => name === "layerchange").length;
  assert.equal(told(), 0);
  of.show(0, -1, { layer: 1 });
  of.show(1, 0, { layer: 1 });
  assert.equal(told(), 1);
  of.show(2, 0, { layer: 0 });
  assert.equal(told(), 2);
});

test("an error pauses, is told, and is tried again by whoever plays", async () => {
  const of = ready();
  void of.session.play();
  of.run(6);
  of.worker.say({ type: "failed", request: 9, message: "the server answers 500" });
  assert.equal(of.session.error, "the server answers 500");
  assert.deepEqual(of.events.slice(-2), ["pause", "error"]);
  assert.equal(of.warnings.at(-1), "the server answers 500");
  const due = of.session.playback.due;
  const played = of.session.play();
  assert.equal(of.session.error, null);
  assert.deepEqual([of.reopened, of.asked().at(-1)], [0, due]);
  assert.equal(await outcome(played), "resolved");
});

test("after an error, a frame that comes is no error any more", () => {
  const of = ready();
  of.worker.say({ type: "failed", request: 9, message: "frame 9 is damaged" });
  of.session.seek(3);
  of.show(3);
  assert.equal(of.session.error, null);
  assert.equal(of.warnings.at(-1), null);
});

test("what frames cost, packing and sorting too, says how many may be passed over; what is sent again costs nothing", () => {
  const of = ready();
  void of.session.play();
  of.run(2);
  for (let frame = 1; frame < 12; frame++) of.show(frame, 100, { decodeMs: 10, packMs: 40 });
  for (let again = 0; again < 30; again++) of.show(11, -1, { decodeMs: 0, packMs: 0 });
  of.session.advance(2);
  assert.equal(of.session.playback.due, 12);
});

test("a stream that could not be opened is opened anew by whoever plays", () => {
  const of = new Opened();
  of.worker.say({ type: "failed", request: null, message: "HTTP 404" });
  assert.equal(of.session.error, "HTTP 404");
  void of.session.play().catch(() => undefined);
  assert.equal(of.reopened, 1);
});

test("a whole stream without a frame is an error", () => {
  const of = new Opened({ frames: 0, complete: false }).begin();
  of.progress({ complete: true, notices: ["it is cut off"] });
  of.progress({ complete: true, notices: ["it is cut off"] });
  assert.equal(of.session.error, "it is cut off");
  assert.equal(of.events.filter((name) => name === "error").length, 1);
  assert.equal(of.loading.at(-1), false);
});

test("the worst of what is wrong is said: the error, the network, the frame, the stream", () => {
  const of = ready();
  of.progress({ notices: ["a lost index", "an odd end"] });
  assert.equal(of.warnings.at(-1), "an odd end");
  of.show(0, 0, { damage: "a broken frame" });
  assert.equal(of.warnings.at(-1), "a broken frame");
  of.progress({ notices: ["an odd end"], trouble: "offline" });
  assert.equal(of.warnings.at(-1), "Trying again: offline");
  of.progress({ notices: ["an odd end"], trouble: "offline" });
  assert.equal(of.events.filter((name) => name === "stalled").length, 1);
  of.worker.say({ type: "failed", request: null, message: "gone" });
  assert.equal(of.warnings.at(-1), "gone");
});

test("what is known of frames is kept, and buffers go back to the worker", () => {
  const of = ready();
  of.progress({ bytesRead: 77, psnr: [[3, 31.5]], buffered: [[0, 9]], refined: [[0, 4]], frames: frameTable(91, 90) });
  assert.deepEqual([of.session.bytesRead, of.session.frames.psnr.get(3), of.session.frames.count], [77, 31.5, 91]);
  assert.deepEqual([of.session.buffered, of.session.refined], [[[0, 9]], [[0, 4]]]);
  assert.equal(of.session.playback.frameCount, 91);
  of.progress();
  assert.equal(of.events.filter((name) => name === "durationchange").length, 2);
  assert.deepEqual(of.worker.asked("recycle")[0].buffers.map(({ byteLength }) => byteLength), [16]);
});

test("time is counted in the stream's own frames a second, or 30 where it does not say", () => {
  assert.equal(new Opened({ of: { fps: 25 } }).begin().session.playback.fps, 25);
  assert.equal(new Opened({ of: { fps: null } }).begin().session.playback.fps, 30);
});

test("people see how much has come of what is waited for, and only then", () => {
  const of = new Opened().begin();
  of.progress({ share: 0.4 });
  assert.deepEqual(of.busy.at(-1), [true, 0.4]);
  of.show(0);
  assert.deepEqual(of.busy.at(-1), [false, null]);
  of.progress({ share: null });
  assert.deepEqual(of.busy.at(-1), [false, null]);
  of.session.seek(40);
  mock.timers.tick(200);
  of.progress({ share: 0.7 });
  assert.deepEqual(of.busy.at(-1), [true, 0.7]);
  assert.deepEqual(of.loading, [true, false]);
});

test("a closed stream leaves nothing behind, and tells it once", () => {
  const of = ready({ frames: 12 });
  void of.session.play();
  of.run(20);
  assert.ok(of.session.playback.ended);
  of.progress({ notices: ["an odd end"] });
  of.session.close();
  assert.equal(of.warnings.at(-1), null);
  const { header: none, info: nothing, position, frames, playback } = of.session;
  assert.deepEqual([none, nothing, position, frames.count, playback.playing, playback.ended], [null, null, 0, 0, false, false]);
  assert.equal(of.events.at(-1), "emptied");
  const before = of.events.length;
  of.session.seek(4);
  of.session.close();
  assert.equal(of.events.length, before);
  const late = ready();
  late.session.seek(4);
  late.session.close();
  late.busy.length = 0;
  mock.timers.tick(1000);
  assert.deepEqual(late.busy, [], "nobody waits for it");
});
