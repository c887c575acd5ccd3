/** What people take along, what notices say and for how long, and which cameras are offered where. */
import { FakeElement } from "../element/page";
import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";
import { CameraChoice } from "../../src/controls/camera_choice";
import { KEY_ACTIONS, forgetKeys, looksInto, playOrPause, type KeyPanels } from "../../src/controls/keys";
import { Legend } from "../../src/controls/legend";
import { Notices } from "../../src/controls/notices";
import { Sharing } from "../../src/controls/sharing";
import type { PlayerApi } from "../../src/player_api";

const html = (element: FakeElement): HTMLElement => element as unknown as HTMLElement;
const turn = (): Promise<void> => new Promise((done) => setImmediate(done));

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setTimeout"] });
});

function noticesIn(): { readonly notice: FakeElement; readonly notices: Notices } {
  const notice = new FakeElement();
  return { notice, notices: new Notices(html(notice)) };
}

test("a hint goes by itself, and gives way to what is wrong; nothing is hinted meanwhile", () => {
  const { notice, notices } = noticesIn();
  notices.hint("Drag to look around");
  assert.deepEqual([notice.textContent, notice.hidden, notice.classList.has("warning")], ["Drag to look around", false, false]);
  mock.timers.tick(2599);
  assert.equal(notice.hidden, false);
  mock.timers.tick(1);
  assert.equal(notice.hidden, true);
  notices.warn("out of memory");
  notices.hint("Drag to look around");
  assert.deepEqual([notice.textContent, notice.classList.has("warning")], ["out of memory", true]);
  mock.timers.tick(60_000);
  assert.equal(notice.hidden, false);
  notices.say("Copied");
  assert.deepEqual([notice.textContent, notice.classList.has("warning")], ["Copied", false]);
  mock.timers.tick(2600);
  assert.deepEqual([notice.textContent, notice.classList.has("warning")], ["out of memory", true]);
  notices.warn(null);
  assert.equal(notice.hidden, true);
});

test("what is wrong still does not take the place of what was said since", () => {
  const { notice, notices } = noticesIn();
  notices.warn("slow");
  notices.say("Copied");
  notices.warn("slow");
  assert.equal(notice.textContent, "Copied");
  notices.warn("gone");
  assert.equal(notice.textContent, "gone");
});

const view = { pose: { centre: [1, 2, 3], axes: [[1, 0, 0], [0, 1, 0], [0, 0, 1]] }, lens: { width: 200, height: 150, fx: 160, fy: 160, cx: 100, cy: 75, near: 0 } };

/** Sharing of a player, and what comes of it. */
function sharing(player: Readonly<Record<string, unknown>>) {
  const { notice, notices } = noticesIn();
  const [copied, asked, links]: [string[], string[], FakeElement[]] = [[], [], []];
  const made = { camera: "", info: { frame: 7 }, view, currentFrame: 7, currentCamera: () => null, ...player };
  Object.defineProperty(globalThis, "navigator", { value: { clipboard: { writeText: (text: string) => { copied.push(text); return Promise.resolve(); } } }, configurable: true });
  Object.assign(globalThis, {
    window: globalThis,
    location: { href: "http://localhost/page/?a=1&b=%22" },
    prompt: (_: string, text: string) => asked.push(text),
  });
  Object.assign(document, { createElement: (name: string) => { links.push(new FakeElement(name)); return links.at(-1); } });
  return { of: new Sharing(made as unknown as PlayerApi, notices), notice, copied, asked, links };
}

test("pictures and frames are saved under the names of camera and frame; what fails is said", async () => {
  const { of, links, notice } = sharing({ capture: () => Promise.resolve(new Blob()), ply: () => Promise.reject(new Error("out of memory")) });
  await of.savePicture();
  const [link] = links as unknown as { readonly download: string; readonly href: string; readonly clicks: number }[];
  assert.deepEqual([link.download, link.clicks, link.href.startsWith("blob:")], ["view_0007.png", 1, true]);
  await of.savePly();
  assert.equal(notice.textContent, "out of memory");
  const named = sharing({ camera: "left", info: null, capture: () => Promise.resolve(new Blob()), ply: () => Promise.resolve(new Blob()) });
  await named.of.savePicture();
  await named.of.savePly();
  assert.deepEqual((named.links as unknown as { readonly download: string }[]).map(({ download }) => download), ["left_0000.png", "frame_0000.ply"]);
});

test("a link has the view and the frame, and code to embed it stands in quotes", async () => {
  const { of, copied, notice } = sharing({});
  await of.copyLink();
  assert.match(copied[0], /^http:\/\/localhost\/page\/\?a=1&b=%22#camera=.*&frame=7$/);
  assert.equal(notice.textContent, "Copied: a link to this view and frame");
  await of.copyEmbed();
  assert.match(copied[1], /^<iframe src="http:\/\/localhost\/page\/\?a=1&amp;b=%22#camera=[^"&]*&amp;frame=7" /);
  const without = sharing({ view: null });
  await without.of.copyLink();
  assert.deepEqual(without.copied, ["http://localhost/page/?a=1&b=%22"]);
});

test("without leave for the clipboard the text is shown, to be copied by hand; without a camera there is none", async () => {
  const { of, asked, copied, notice } = sharing({});
  await of.copyPose();
  assert.deepEqual([copied, asked], [[], []]);
  Object.defineProperty(globalThis, "navigator", { value: {}, configurable: true });
  await of.copyLink();
  assert.equal(asked.length, 1);
  assert.equal(notice.textContent, "");
});

test("what an overlay's colours mean is shown with it, and written once", () => {
  const panel = new FakeElement();
  const player = { overlay: "none" };
  const legend = new Legend(player as PlayerApi, html(panel));
  panel.hidden = true;
  legend.refresh();
  assert.equal(panel.innerHTML, "");
  player.overlay = "motion";
  legend.refresh();
  assert.match(panel.innerHTML, /changed since the keyframe/);
  assert.equal(panel.hidden, false);
  panel.innerHTML = "kept";
  legend.refresh();
  assert.equal(panel.innerHTML, "kept");
  player.overlay = "none";
  legend.refresh();
  assert.deepEqual([panel.innerHTML, panel.hidden], ["", true]);
});

test("cameras are listed once a stream, chosen by their place, and stand in the menu where the bar is narrow", () => {
  const [row, menu, cameras, beside] = [new FakeElement(), new FakeElement(), new FakeElement(), new FakeElement()];
  row.append(cameras, beside);
  const looked: number[] = [];
  const header = { cameras: [{ name: "a" }, { name: "b" }], heldOut: ["b"] };
  const player = { clientWidth: 900, camera: "b", header: null as unknown, lookThrough: (index: number) => looked.push(index) };
  const choice = new CameraChoice(player as unknown as PlayerApi, html(cameras), html(beside), html(menu));
  const select = cameras.querySelector("select");
  choice.refresh();
  assert.deepEqual([select.children, select.value, menu.contains(cameras)], [[], "", false]);
  player.header = header;
  choice.refresh();
  assert.deepEqual(select.children.map(({ textContent, value, hidden }) => [textContent, value, hidden]), [["free view", "", true], ["a", "0", false], ["b (held out)", "1", false]]);
  assert.equal(select.value, "1");
  const before = [...select.children];
  player.camera = "";
  choice.refresh();
  assert.equal(select.value, "");
  assert.ok(before.every((option, index) => option === select.children[index]));
  select.dispatchEvent(new Event("change"));
  select.value = "0";
  select.dispatchEvent(new Event("change"));
  assert.deepEqual(looked, [0]);
  player.clientWidth = 520;
  choice.refresh();
  assert.ok(menu.contains(cameras));
  player.clientWidth = 521;
  choice.refresh();
  assert.ok(!menu.contains(cameras));
});

/** A key, as it comes from the page. */
const key = (key: string, changed: Partial<KeyboardEvent> = {}): KeyboardEvent =>
  ({ type: "keydown", key, code: "", shiftKey: false, ctrlKey: false, metaKey: false, altKey: false, composedPath: () => [], ...changed }) as unknown as KeyboardEvent;

test("keys do what the help says, and are others' where there was nothing to do", async () => {
  const done: string[] = [];
  const note = (what: string) => () => { done.push(what); };
  let open = true;
  const panels = {
    mark: note("mark"), toggleStatistics: note("figures"), toggleHelp: note("help"), savePicture: note("picture"), toggleFullScreen: note("full"),
    closeAll: () => { done.push("close"); return open; },
    leaveFullWindow: () => { done.push("leave"); return false; },
  } as unknown as KeyPanels;
  const player = {
    paused: true, muted: false, loop: false, recorded: false, comparing: false, overlay: "none", playbackRate: 1, currentFrame: 40, currentTime: 0, duration: 3,
    frames: { count: 90, keyframe: (at: number, step: number) => at + 10 * step },
    play: () => { done.push("play"); return Promise.reject(new Error("it is in the notice")); },
    pause: note("pause"), nextCamera: (step: number) => { done.push(`camera ${step}`); }, backToCamera: note("back"),
    fly: (direction: readonly number[]) => { done.push(`fly ${direction.join()}`); },
  };
  const api = player as unknown as PlayerApi;
  const press = (name: string, changed: Partial<KeyboardEvent> = {}): boolean => looksInto(api, panels, key(name, changed));
  for (const name of ["x", "i", "?", "p", "F", "]", "[", "r", " "]) assert.ok(press(name), name);
  assert.deepEqual(done.splice(0), ["mark", "figures", "help", "picture", "full", "camera 1", "camera -1", "back", "play"]);
  press("ArrowRight");
  assert.equal(player.currentFrame, 41);
  press(",", { shiftKey: true });
  assert.equal(player.currentFrame, 31);
  press("End");
  press("5");
  assert.deepEqual([player.currentFrame, player.currentTime], [89, 1.5]);
  press("+");
  assert.equal(player.playbackRate, 2);
  press("-");
  press("-");
  assert.equal(player.playbackRate, 0.5);
  press("c");
  press("m");
  assert.deepEqual([player.overlay, player.muted], ["changes", true]);
  done.length = 0;
  assert.ok(press("Escape"));
  open = false;
  assert.ok(!press("Escape"));
  assert.deepEqual(done.splice(0), ["close", "close", "leave"]);
  assert.ok(!press("x", { ctrlKey: true }) && !press("y") && !press("x", { type: "keyup" }));
  assert.deepEqual(done, []);
  press("w", { code: "KeyW" });
  press("d", { code: "KeyD", shiftKey: true });
  press("w", { code: "KeyW", type: "keyup" });
  forgetKeys(api);
  press("a", { code: "KeyA" });
  assert.deepEqual(done.splice(0), ["fly 0,0,1", "fly 3,0,3", "fly 1,0,0", "fly -1,0,0"]);
  playOrPause({ ...player, paused: false } as unknown as PlayerApi);
  assert.deepEqual(done, ["pause"]);
  await turn();
  assert.equal(new Set(KEY_ACTIONS.flatMap(({ keys }) => keys)).size, KEY_ACTIONS.flatMap(({ keys }) => keys).length);
});
