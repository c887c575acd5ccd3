/** The element: when a stream is opened, waited with, left and taken up again; what attributes do, and what members give. */
import { FakeElement, FakeObserver, page, picture, waiting } from "./page";
import { FakeWorker, frameTable, header, info, turn } from "./browser";
import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";
import { DecogsPlayer } from "../../src/element/player";
import type { ExactAnswer, ToWorker } from "../../src/messages";
import type { RigCamera, StreamHeader } from "../../src/scene";

const SOURCE = "http://localhost/page/a.dgs";
const camera = (name: string, x: number) =>
  ({ name, width: 200, height: 150, fx: 160, fy: 160, cx: 100, cy: 75, near: 0, distortionModel: "none", distortion: [], colours: null, falloff: 0, lamp: null, lampAmplitude: 0, worldToCamera: [[1, 0, 0, -x], [0, 1, 0, 0], [0, 0, 1, 0]] }) as RigCamera;
const STREAM = { cameras: [camera("a", 0), camera("b", 1)], heldOut: [], corrected: new Map(), background: [0, 0, 0], subject: false } as Partial<StreamHeader>;

type Fake = FakeElement & { isConnected: boolean };
const fake = (player: DecogsPlayer): Fake => player as unknown as Fake;

/** An element with these attributes, in the page. */
function put(attributes: Readonly<Record<string, string>> = { src: "a.dgs" }): DecogsPlayer {
  const player = new DecogsPlayer();
  for (const [name, value] of Object.entries(attributes)) player.setAttribute(name, value);
  enter(player);
  return player;
}

function enter(player: DecogsPlayer): void {
  fake(player).isConnected = true;
  player.connectedCallback();
}

async function leave(player: DecogsPlayer): Promise<void> {
  fake(player).isConnected = false;
  player.disconnectedCallback();
  await turn();
}

/** What the element tells, as it does. */
function events(player: DecogsPlayer, ...names: string[]): string[] {
  const told: string[] = [];
  for (const name of names) player.addEventListener(name, () => told.push(name));
  return told;
}

/** The stream's header comes, and its first frame, or another. */
function come(changed: Partial<StreamHeader> = {}, frame = 0): void {
  FakeWorker.opened.say({ type: "opened", header: header({ ...STREAM, ...changed }), layout: { shDegree: 0, restTexels: 0 }, frames: frameTable(90), complete: true });
  show(frame);
}

function show(frame: number): void {
  const request = FakeWorker.opened.asked("show").at(-1)?.request ?? 0;
  const serial = FakeWorker.opened.asked("view").at(-1)?.serial ?? 0;
  FakeWorker.opened.say({ type: "frame", request, info: info(frame), update: null, draw: { order: new Uint32Array(1), count: 7, sortMs: 2, serial } });
}

/** The kernel draws what it is asked for. */
function drawn(answer: Partial<ExactAnswer> = {}): void {
  const one = { width: 2, height: 1, pixels: new Uint8ClampedArray(8), drawMs: 3 };
  FakeWorker.opened.say({ type: "exact", picture: one, problem: null, kernel: true, ...answer });
}

/** Whether a stream has been asked for since the last test began. */
const opened = (): boolean => (FakeWorker.opened as FakeWorker | undefined) !== undefined;
const last = <T extends ToWorker["type"]>(type: T): Extract<ToWorker, { type: T }> => FakeWorker.opened.asked(type).at(-1)!;

/** Pictures come and are drawn, from a time on, until nothing is to be changed by them. */
function rest(now: number): void {
  for (let turns = 0; turns < 5; turns++) {
    picture(now + 100 * turns);
    drawn();
  }
  picture(now + 1000);
}

interface Inside {
  readonly ticking: number;
  readonly stage: { readonly navigation: { readonly isSwaying: boolean; readonly limited: boolean; readonly fence: { outside(centre: readonly [number, number, number]): number } | null } };
}
const inside = (player: DecogsPlayer): Inside => (player as unknown as Record<symbol, Inside>)[Symbol.for("decogs.inside")];

/** Where somebody sees it, or not. */
const seen = (isIntersecting: boolean): void => { FakeObserver.last.tell([{ isIntersecting }]); };

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setTimeout"] });
  waiting.clear();
  page.hidden = false;
  (FakeWorker as { opened: FakeWorker | undefined }).opened = undefined;
});

test("an element in a page opens its stream, with what its attributes say of it", () => {
  const player = put({ src: "a.dgs", follow: "", crossorigin: "use-credentials", preload: "metadata" });
  assert.equal(player.currentSrc, SOURCE);
  const { source, follow, credentials, sparing } = last("open");
  assert.deepEqual({ source, follow, credentials, sparing }, { source: SOURCE, follow: true, credentials: "include", sparing: true });
  put({ src: "a.dgs", preload: "metadata", autoplay: "" });
  assert.deepEqual([last("open").sparing, last("open").follow, last("open").credentials], [false, false, undefined]);
});

test("layers are kept within what the page says, from the next frame on", () => {
  const player = put({ src: "a.dgs", "max-gaussians": "50000" });
  assert.deepEqual(last("budget").budget, { gaussians: 50_000 });
  player.maxBitrate = 2e6;
  assert.deepEqual(last("budget").budget, { gaussians: 50_000, bitsPerSecond: 2e6 });
  player.maxGaussians = null;
  assert.deepEqual(last("budget").budget, { bitsPerSecond: 2e6 });
  player.setAttribute("max-bitrate", "many");
  assert.deepEqual([last("budget").budget, player.maxBitrate], [{}, null]);
});

test("outside of a page nothing is opened; another address opens another stream", () => {
  const player = new DecogsPlayer();
  player.src = "a.dgs";
  player.load();
  assert.ok(!opened());
  enter(player);
  const first = FakeWorker.opened;
  player.src = "b.dgs";
  assert.ok(first.terminated);
  assert.equal(last("open").source, "http://localhost/page/b.dgs");
  const second = FakeWorker.opened;
  player.load();
  assert.notEqual(FakeWorker.opened, second);
});

test("what is no address is an error, and the empty one opens nothing", () => {
  const player = put({ src: "http://[" });
  assert.match(player.error!, /^http:\/\/\[ is no address$/);
  put({ src: "" });
  assert.ok(!opened());
});

test("with preload none nothing is read before somebody plays, or something else is wanted of it", async () => {
  const player = put({ src: "a.dgs", preload: "none" });
  assert.ok(!opened());
  assert.equal(player.currentSrc, SOURCE);
  const playing = player.play();
  assert.equal(last("open").source, SOURCE);
  come();
  drawn();
  await playing;
  assert.equal(player.paused, false);

  (FakeWorker as { opened: FakeWorker | undefined }).opened = undefined;
  const waits = put({ src: "a.dgs", preload: "none" });
  assert.ok(!opened());
  waits.preload = "auto";
  assert.ok(opened());

  (FakeWorker as { opened: FakeWorker | undefined }).opened = undefined;
  put({ src: "a.dgs", preload: "none", autoplay: "" });
  assert.ok(opened());
});

test("an element that is moved in the page goes on; one that leaves gives all back and takes up frame and view when it comes again", async () => {
  const player = put();
  come();
  const { opened: worker } = FakeWorker;
  player.currentFrame = 30;
  show(30);
  fake(player).isConnected = false;
  player.disconnectedCallback();
  enter(player); // before anything else happens
  await turn();
  assert.ok(!worker.terminated);

  player.lookThrough(1, true);
  await leave(player);
  assert.ok(worker.terminated);
  assert.equal(player.header, null);
  enter(player);
  assert.equal(last("open").first, 30);
  come({}, 30);
  assert.deepEqual([player.camera, player.currentFrame], ["b", 30]);

  const free = { pose: { ...player.view!.pose, centre: [5, 6, 7] as const }, lens: player.view!.lens };
  player.lookFrom(free.pose, free.lens);
  await leave(player);
  enter(player);
  come({}, 30);
  assert.equal(player.camera, "");
  assert.deepEqual(player.view!.pose.centre, [5, 6, 7]);

  await leave(player);
  player.src = "b.dgs"; // another stream begins at its own beginning
  enter(player);
  assert.equal(last("open").first, 0);
  come();
  assert.equal(player.camera, "a");
});

test("a stream that was left is taken up at once, though preload is none", async () => {
  const player = put({ src: "a.dgs", preload: "none" });
  player.play().catch(() => undefined);
  come();
  await leave(player);
  (FakeWorker as { opened: FakeWorker | undefined }).opened = undefined;
  enter(player);
  assert.ok(opened());
});

test("nobody who does not see it has it play: it pauses, and goes on when it is seen", async () => {
  const player = put();
  come();
  drawn();
  await player.play();
  const told = events(player, "play", "pause");
  seen(false);
  assert.equal(player.paused, true);
  seen(true);
  assert.equal(player.paused, false);
  page.hidden = true;
  page.dispatchEvent(new Event("visibilitychange"));
  assert.equal(player.paused, true);
  player.pause(); // somebody's own pause stays
  page.hidden = false;
  page.dispatchEvent(new Event("visibilitychange"));
  assert.equal(player.paused, true);
  assert.deepEqual(told, ["pause", "play", "pause"]);
});

test("autoplay begins when it comes into sight", () => {
  const player = put({ src: "a.dgs", autoplay: "" });
  seen(false);
  come();
  assert.equal(player.paused, true);
  seen(true);
  assert.equal(player.paused, false);
  const other = put({ src: "a.dgs", autoplay: "" });
  come();
  assert.equal(other.paused, false);
});

test("time runs with pictures, a tenth of a second at most for each, and none is waited for in a pause", async () => {
  const player = put();
  come();
  drawn();
  await player.play();
  picture(1000); // time begins with it
  picture(1050);
  assert.ok(Math.abs(player.currentTime - 0.05) < 1e-9, String(player.currentTime));
  picture(9000);
  assert.ok(Math.abs(player.currentTime - 0.15) < 1e-9, String(player.currentTime));
  player.pause();
  show(player.currentFrame);
  rest(10_000);
  assert.equal(inside(player).ticking, 0);
  player.currentFrame = 3;
  assert.notEqual(inside(player).ticking, 0);
});

test("out of sight nothing is drawn, but play() has the kernel's first picture that it waits for", async () => {
  const player = put();
  come();
  seen(false);
  picture(0);
  assert.equal(FakeWorker.opened.asked("exact").length, 0);
  const playing = player.play();
  picture(20);
  assert.equal(FakeWorker.opened.asked("exact").length, 1);
  drawn();
  await playing;
});

test("names, roles and keys are the page author's, or the stream's title", () => {
  const player = put();
  assert.deepEqual([player.getAttribute("aria-label"), player.getAttribute("role"), player.tabIndex], ["Free-viewpoint video", "region", 0]);
  const presentation = { title: "Two dancers", poster: null, firstView: null, transform: null };
  come({ presentation });
  assert.equal(player.getAttribute("aria-label"), "Two dancers");
  player.src = "b.dgs";
  come();
  assert.equal(player.getAttribute("aria-label"), "Free-viewpoint video");
  const own = put({ src: "a.dgs", "aria-label": "Mine", role: "img", tabindex: "-1" });
  come({ presentation });
  assert.deepEqual([own.getAttribute("aria-label"), own.getAttribute("role"), own.tabIndex], ["Mine", "img", undefined]);
});

test("attributes reach what they are of, before and after the stream", () => {
  const player = put({ src: "a.dgs", camera: "b", loop: "", range: "3:9", quality: "0.5", muted: "" });
  come();
  assert.deepEqual([player.camera, player.loop, player.muted, player.quality], ["b", true, true, 0.5]);
  assert.equal(last("detail").share, 0.75);
  player.quality = 1;
  assert.equal(last("detail").share, 1);
  player.removeAttribute("muted");
  assert.equal(player.muted, false);
  player.setAttribute("camera", "a");
  assert.equal(player.camera, "a");
  const { stage } = inside(player);
  player.setAttribute("orbit", "");
  player.setAttribute("limits", "rig");
  assert.deepEqual([stage.navigation.isSwaying, stage.navigation.limited], [true, true]);
  player.removeAttribute("orbit");
  player.setAttribute("limits", "none");
  assert.deepEqual([stage.navigation.isSwaying, stage.navigation.limited], [false, false]);
});

test("a fence is read from where it lies; until then, and without it, the rig's own limits hold", async (context) => {
  const map = { axes: [[1, 0, 0], [0, 0, 1]], low: [0, 0], high: [1, 1], within: [[true]] };
  const answers = new Map([["good.json", Response.json(map)], ["page.html", new Response("<p>")]]);
  const fetched = context.mock.method(globalThis, "fetch", (address: string) => Promise.resolve(answers.get(address) ?? new Response("", { status: 404 })));
  const warned = context.mock.method(console, "warn", () => undefined);
  const player = put({ src: "a.dgs", fence: "good.json" });
  come();
  const { navigation } = inside(player).stage;
  assert.deepEqual([navigation.limited, navigation.fence], [true, null]);
  await settled();
  assert.equal(navigation.fence?.outside([0.5, 9, 0.5]), 0);
  for (const [address, why] of [["none.json", /fence none\.json: HTTP 404/], ["page.html", /fence page\.html: .*JSON/]] as const) {
    player.setAttribute("fence", address);
    await settled();
    assert.deepEqual([navigation.limited, navigation.fence], [true, null]);
    assert.match(String(warned.mock.calls.at(-1)?.arguments[0]), why);
  }
  player.removeAttribute("fence");
  assert.equal(navigation.limited, false);
  assert.equal(fetched.mock.callCount(), 3);
});

/** What was fetched has been read. */
async function settled(): Promise<void> {
  for (let i = 0; i < 5; i++) await new Promise((resolve) => setImmediate(resolve));
}

test("the background lies behind a picture of a subject, or one that the author wants to be clear", () => {
  const player = put({ src: "a.dgs", background: "red" });
  come();
  const [canvas] = fake(player).shadowRoot!.children.filter(({ name }) => name === "canvas");
  assert.deepEqual([canvas.classList.has("clear"), canvas.style.backgroundColor], [false, ""], "not a whole scene");
  player.src = "b.dgs";
  come({ subject: true });
  assert.deepEqual([canvas.classList.has("clear"), canvas.style.backgroundColor], [true, "red"]);
  player.setAttribute("background", "blue");
  assert.equal(canvas.style.backgroundColor, "blue");
});

test("overlays are one of three, and stay with another stream's canvases", async () => {
  const player = put();
  assert.throws(() => { player.overlay = "heat" as "none"; }, RangeError);
  player.overlay = "motion";
  await leave(player);
  enter(player);
  assert.equal(player.overlay, "motion");
});

test("pictures are as large as the element's pixels on the screen, or as is asked", async () => {
  Object.assign(globalThis, { devicePixelRatio: 2 });
  const player = put();
  assert.equal(new DecogsPlayer().currentCamera(), null);
  await assert.rejects(player.capture(), /there is no picture yet/);
  await assert.rejects(player.ply(), /there is no frame yet/);
  assert.equal(await player.thumbnail(0, 100), null);
  come();
  const { width, height } = player.currentCamera()!;
  assert.deepEqual([width, height], [400, 300]);
  const other = player.currentCamera(100)!;
  assert.deepEqual([other.width, other.height], [100, 300]);
  const still = player.thumbnail(12, 100);
  const { frame, camera: from } = last("still");
  assert.deepEqual([frame, from.width, from.height, from.recording], [12, 100, 75, null]);
  FakeWorker.opened.say({ type: "still", picture: null });
  assert.equal(await still, null);
  const made = player.ply();
  FakeWorker.opened.say({ type: "ply", bytes: new Uint8Array([1, 2, 3]), problem: "" });
  assert.equal((await made).size, 3);
  Object.assign(globalThis, { devicePixelRatio: 1 });
});

test("recordings lie where the template says, of a camera of the rig alone; they are compared only where there are any", () => {
  const player = put();
  come();
  player.comparing = true;
  assert.deepEqual([player.comparing, player.recorded], [false, false]);
  assert.equal(player.recordingAddress(), "");
  player.setAttribute("recordings", "rec/{camera}/{frame}.jpg");
  assert.equal(player.recordingAddress(), "http://localhost/page/rec/a/0.jpg");
  player.comparing = true;
  assert.deepEqual([player.comparing, player.recorded], [true, true]);
  player.lookFrom(player.view!.pose, player.view!.lens);
  assert.equal(player.recordingAddress(), "");
});

test("how much is there is counted as <video> does", () => {
  const player = put();
  assert.deepEqual([player.readyState, player.videoWidth, player.seekable.length, player.figures], [0, 0, 0, null]);
  const nothing = { bytesRead: 50, complete: true, frames: null, psnr: [], notices: [], trouble: null, share: null };
  const buffered = (...spans: [number, number][]): number => {
    FakeWorker.opened.say({ type: "progress", ...nothing, refined: [], buffered: spans });
    return player.readyState;
  };
  FakeWorker.opened.say({ type: "opened", header: header(STREAM), layout: { shDegree: 0, restTexels: 0 }, frames: frameTable(90), complete: true });
  assert.equal(player.readyState, 1);
  show(0);
  assert.equal(buffered(), 2);
  assert.equal(buffered([0, 1], [5, 90]), 2);
  assert.equal(buffered([0, 2]), 3);
  assert.equal(buffered([0, 90]), 4);
  assert.deepEqual([player.buffered.end(0), player.seekable.end(0), player.duration], [3, 3, 3]);
  assert.deepEqual([player.videoWidth, player.videoHeight], [200, 150]);
  const { drawn: count, sortMs, bytesRead } = player.figures!;
  assert.deepEqual([count, sortMs, bytesRead], [7, 2, 50]);
});

test("a moment that was set before the header came is where the stream begins, in seconds or frames", () => {
  for (const [set, frame] of [[{ currentTime: 2 }, 60], [{ currentFrame: 7.4 }, 7], [{ currentTime: -3 }, 0], [{ currentTime: NaN }, 0], [{ currentFrame: Infinity }, 0]] as const) {
    const player = new DecogsPlayer();
    player.src = "a.dgs";
    Object.assign(player, set);
    enter(player);
    assert.equal(player.currentFrame, frame);
    come({}, frame);
    assert.equal(player.currentFrame, frame);
  }
});

test("an element without focus flies no further", () => {
  const player = put();
  come();
  player.fly([1, 0, 0]);
  picture(0);
  drawn();
  assert.notEqual(inside(player).ticking, 0);
  player.dispatchEvent(new Event("blur"));
  rest(1000);
  assert.equal(inside(player).ticking, 0);
});

test("changed sound is told, and may be why it is heard though nobody sees it", () => {
  const player = put();
  const told = events(player, "volumechange", "ratechange");
  player.volume = 0.5;
  player.muted = true;
  player.playbackRate = 2;
  assert.deepEqual([player.volume, player.muted, player.playbackRate, told], [0.5, true, 2, ["volumechange", "volumechange", "ratechange"]]);
});
