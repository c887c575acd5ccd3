/** Parts of the element that decide something: its poster, callbacks of frames, whether it is seen, properties that came early. */
import { FakeElement, FakeObserver, page, picture, reported, waiting } from "./page";
import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { AttributeElement, takeOverProperties } from "../../src/element/attributes";
import { FrameCallbacks } from "../../src/element/frame_callbacks";
import { Poster } from "../../src/element/poster";
import { Sight } from "../../src/element/sight";
import { Ticker } from "../../src/element/ticker";

beforeEach(() => {
  reported.length = 0;
});

class Player extends AttributeElement {
  frame = 0;
  constructor() {
    super();
    Reflect.deleteProperty(this, "frame"); // only what somebody sets lies on it
  }
  get currentTime(): number {
    return 7;
  }
  set currentTime(value: number) {
    this.setAttribute("time", String(value));
  }
  get paused(): boolean {
    return true;
  }
  play(): string {
    return "played";
  }
}

const keptBy = (element: unknown): object => Object.fromEntries((element as FakeElement).kept);

/** An element that a page has filled before it was defined. */
function early(values: Readonly<Record<string, unknown>>): Player {
  const element = new Player();
  for (const [name, value] of Object.entries(values)) Object.defineProperty(element, name, { value, writable: true, enumerable: true, configurable: true });
  return element;
}

test("properties that were set before the element was defined are taken over, whichever class has them", () => {
  const values = { src: "a.dgs", loop: true, controls: true, poster: "a.jpg", preload: "none", crossOrigin: "use-credentials", quality: 0.5, recorded: true, autoplay: false, currentTime: 3 };
  const element = early(values);
  assert.equal(element.hasAttribute("src"), false);
  takeOverProperties(element);
  assert.deepEqual(keptBy(element), { src: "a.dgs", loop: "", controls: "", poster: "a.jpg", preload: "none", crossorigin: "use-credentials", quality: "0.5", recorded: "", time: "3" });
  element.src = "b.dgs";
  assert.equal(element.getAttribute("src"), "b.dgs");
  element.loop = false;
  assert.equal(element.hasAttribute("loop"), false);
});

test("the address comes last, since others say how it is opened", () => {
  const element = early({ src: "a.dgs", preload: "none", crossOrigin: "", range: [3, 9] });
  takeOverProperties(element);
  assert.deepEqual(Object.keys(keptBy(element)), ["preload", "crossorigin", "range", "src"]);
  assert.deepEqual(element.range, [3, 9]);
});

test("what can only be read, methods of the page's own and other properties do no harm; what is refused is told, and the rest counts", () => {
  const play = (): string => "the page's";
  const element = early({ paused: false, mine: 1, quality: 7, play, src: "a.dgs" });
  takeOverProperties(element);
  assert.equal(element.paused, true);
  assert.equal(element.play(), "the page's");
  assert.equal((element as unknown as { mine: number }).mine, 1);
  assert.equal(element.src, "a.dgs");
  assert.equal(element.quality, 1);
  assert.ok(reported[0] instanceof RangeError);
});

test("attributes of few values are one of them", () => {
  const element = new Player();
  assert.deepEqual([element.preload, element.crossOrigin], ["auto", null]);
  for (const [value, found] of [["none", "none"], ["METADATA", "metadata"], ["", "auto"], ["much", "auto"]] as const) {
    element.setAttribute("preload", value);
    assert.equal(element.preload, found);
  }
  for (const [value, found] of [["", "anonymous"], ["use-credentials", "use-credentials"], ["what", "anonymous"]] as const) {
    element.setAttribute("crossorigin", value);
    assert.equal(element.crossOrigin, found);
  }
  for (const [value, found] of [["12:48", [12, 48]], [" 3 : 4 ", [3, 4]], ["4:4", null], ["9:3", null], ["a", null], ["1:", null]] as const) {
    element.setAttribute("range", value);
    assert.deepEqual(element.range, found);
  }
  element.range = null;
  assert.equal(element.hasAttribute("range"), false);
  element.crossOrigin = null;
  assert.equal(element.hasAttribute("crossorigin"), false);
});

/** Whether a poster is seen after some of its life. */
function poster(act: (poster: Poster) => void, address = "a.jpg"): boolean {
  const of = new Poster();
  of.address = address;
  act(of);
  return !of.image.hidden;
}

test("a poster stays until somebody wants to see the stream and there is something to be seen", () => {
  assert.ok(poster(() => undefined));
  assert.ok(poster((of) => { of.drawn(); }), "nobody has played");
  assert.ok(poster((of) => { of.giveWay(); }), "nothing is drawn yet");
  assert.ok(!poster((of) => { of.giveWay(); of.drawn(); }));
  assert.ok(!poster((of) => { of.drawn(); of.giveWay(); }));
  assert.ok(poster((of) => { of.drawn(); of.giveWay(); of.stand(); of.drawn(); }), "another stream");
  assert.ok(poster((of) => { of.drawn(); of.stand(); of.giveWay(); }), "that one is not drawn yet");
});

test("a poster that comes late is shown while it is one, an empty or a missing one never", () => {
  assert.ok(poster((of) => { of.drawn(); of.address = "b.jpg"; }));
  assert.ok(!poster((of) => { of.drawn(); of.giveWay(); of.address = "b.jpg"; }));
  assert.ok(!poster(() => undefined, ""));
  assert.ok(!poster((of) => { of.address = ""; }));
  assert.ok(!poster((of) => { of.image.dispatchEvent(new Event("error")); of.stand(); }));
});

const shown = { width: 200, height: 150, fps: 30, costMs: 4 };

test("a callback is called once, with the next frame that comes into the picture", () => {
  const of = new FrameCallbacks();
  const called: unknown[] = [];
  of.request((now, metadata) => called.push([now, metadata]));
  of.drawn(60, 1000, shown);
  of.drawn(61, 1033, shown);
  assert.deepEqual(called, [
    [1000, { presentationTime: 1000, expectedDisplayTime: 1000, width: 200, height: 150, mediaTime: 2, presentedFrames: 1, processingDuration: 0.004 }],
  ]);
  const times: number[] = [];
  const again = (_: number, { mediaTime }: { readonly mediaTime: number }): void => {
    times.push(mediaTime);
    of.request(again);
  };
  of.request(again);
  of.drawn(61, 1050, shown); // the same frame from elsewhere
  of.drawn(62, 1066, shown);
  of.drawn(30, 1100, shown);
  assert.deepEqual(times, [62 / 30, 1]);
  of.sought();
  of.drawn(30, 1150, shown);
  of.drawn(30, 1166, shown);
  assert.equal(times.length, 3, "the same frame, where it was sought");
  of.begin();
  of.drawn(30, 1200, shown);
  assert.equal(times.length, 4, "another stream's frame of that number");
});

test("a callback that was taken back is not called, even by one before it; one that fails stops no other", () => {
  const of = new FrameCallbacks();
  const called: string[] = [];
  of.request(() => {
    throw new Error("the page's own");
  });
  of.request(() => {
    called.push("one");
    of.cancel(two);
  });
  const two = of.request(() => called.push("two"));
  const three = of.request(() => called.push("three"));
  of.request(() => called.push("four"));
  of.cancel(three);
  of.cancel(99);
  of.drawn(0, 0, shown);
  assert.deepEqual(called, ["one", "four"]);
  assert.equal(reported.length, 1);
});

test("an element is seen where it is in the window of a page that is shown", () => {
  let changes = 0;
  const sight = new Sight(() => changes++);
  const element = new FakeElement() as unknown as HTMLElement;
  sight.begin(element);
  assert.deepEqual([sight.offScreen, sight.pageHidden], [false, false]);
  assert.deepEqual(FakeObserver.last.observed, [element]);
  FakeObserver.last.tell([{ isIntersecting: true }, { isIntersecting: false }]);
  assert.deepEqual([sight.offScreen, changes], [true, 1]);
  FakeObserver.last.tell([{ isIntersecting: true }]);
  assert.deepEqual([sight.offScreen, changes], [false, 2]);
  page.hidden = true;
  page.dispatchEvent(new Event("visibilitychange"));
  assert.deepEqual([sight.pageHidden, changes], [true, 3]);
  assert.deepEqual([sight.isUnseen(true), sight.isUnseen(false)], [true, true]);
  page.hidden = false;
  assert.equal(sight.isUnseen(false), false);
  FakeObserver.last.tell([{ isIntersecting: false }]);
  assert.deepEqual([sight.isUnseen(true), sight.isUnseen(false)], [false, true]);
  sight.end();
  assert.equal(sight.offScreen, false);
  assert.deepEqual(FakeObserver.last.observed, []);
  page.dispatchEvent(new Event("visibilitychange"));
  assert.equal(changes, 4);
});

test("of pictures that are asked for again and again one is waited for, in the window that shows the element", () => {
  const ticks: (readonly [number, number])[] = [];
  const ticker = new Ticker((now, seconds) => ticks.push([now, seconds]));
  ticker.wake();
  ticker.wake();
  assert.equal(waiting.size, 1);
  picture(50);
  assert.deepEqual([ticker.request, waiting.size], [0, 0]);
  ticker.wake();
  picture(70);
  assert.deepEqual(ticks, [[50, 0.05], [70, 0.02]]);

  let asked: ((now: number) => void) | null = null;
  const other = { requestAnimationFrame: (callback: (now: number) => void) => { asked = callback; return 9; }, cancelAnimationFrame: () => { asked = null; } };
  const moved = Object.assign(new EventTarget(), { defaultView: other }) as unknown as Document;
  ticker.wake();
  ticker.moveTo(moved);
  assert.deepEqual([waiting.size, ticker.request], [0, 9], "the window before may have been closed");
  const now = performance.now();
  asked!(3); // each window counts from its own beginning
  assert.ok(ticks[2][0] >= now);
  assert.equal(ticks[2][1], Math.min(0.1, Math.max(0, (ticks[2][0] - 70) / 1000)), "0.1 at most, since the last one");
  ticker.moveTo(moved);
  assert.equal(ticker.request, 0);
  ticker.moveTo(page as unknown as Document);
  assert.equal(waiting.size, 1);
  waiting.clear();
});
