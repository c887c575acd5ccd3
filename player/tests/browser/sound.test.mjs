// Sound: what is put on the clock of Web Audio, and that pictures go by it. The stream's tone is another one each second.
import assert from "node:assert/strict";
import { appendFileSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { firefox, firefoxPath } from "./firefox.mjs";
import { DATA, ready, started, until } from "./harness.mjs";
import { served } from "./server.mjs";

const [FIRST_TONE, STEP] = [400, 150];
const FRAME = 1 / 30;

let browser;
const folder = mkdtempSync(join(tmpdir(), "decogs-sounding-"));
before(async () => (browser = await started({ growing: folder })));
after(async () => {
  await browser.close();
  rmSync(folder, { recursive: true, force: true });
});

/** Notes every source that is started, and where the pictures are by the sound's clock. */
function listening() {
  const heard = { sources: [], places: [], context: null };
  globalThis.heard = heard;
  const Real = AudioContext;
  // What Playwright evaluates counts as a person's touch.
  let touched = false;
  addEventListener("pointerdown", () => (touched = true), true);
  globalThis.AudioContext = class extends Real {
    constructor(options) {
      super(options);
      heard.context = this;
      if (!touched) void super.suspend();
    }
    /** As browsers have it, of which the one under test lets everything sound. */
    resume() {
      return touched ? super.resume() : Promise.reject(new DOMException("nobody touched the page", "NotAllowedError"));
    }
  };
  const { start, stop } = AudioBufferSourceNode.prototype;
  AudioBufferSourceNode.prototype.start = function (when, offset) {
    const { sampleRate, length } = this.buffer;
    this.noted = { when: when - offset / this.playbackRate.value, offset, rate: this.playbackRate.value, length, sampleRate, channels: this.buffer.numberOfChannels, samples: this.buffer.getChannelData(0).slice(), stopped: Infinity };
    heard.sources.push(this.noted);
    start.call(this, when, offset);
  };
  AudioBufferSourceNode.prototype.stop = function () {
    if (this.noted) this.noted.stopped = heard.context.currentTime;
    stop.call(this);
  };
  const note = () => {
    const player = document.querySelector("decogs-player");
    const { context } = heard;
    if (context?.state === "running" && player && !player.paused) heard.places.push([context.currentTime - context.outputLatency, player.currentTime]);
  };
  // Behind the player's own step, which may be the only one for a long time.
  const step = () => {
    setTimeout(note);
    requestAnimationFrame(step);
  };
  requestAnimationFrame(step);
}

/** Opens the stream with tones, ready to play. */
async function opened(query = "") {
  const page = await browser.opened("tones", { query, width: 480, height: 270 });
  await page.addInitScript(listening);
  await page.reload();
  await ready(page);
  await until(page, "inside !== undefined && globalThis.heard.context !== null && player.shadowRoot.querySelector('.bar') !== null");
  return page;
}

/** Pieces from one on, by their time: when they sound, their tone, and the second of the stream with which they begin, where a second ends in them. */
const piecesOf = (page, first = 0) =>
  page.evaluate(
    ([first, lowest, step]) =>
      globalThis.heard.sources
        .slice(first)
        .sort((one, other) => one.when - other.when)
        .map(({ when, rate, samples, sampleRate, channels, stopped }) => {
          const hertz = (from) => {
            const part = samples.subarray(from * sampleRate, (from + 0.2) * sampleRate);
            let crossings = 0;
            for (let at = 1; at < part.length; at++) crossings += part[at - 1] < 0 !== part[at] < 0 ? 1 : 0;
            return crossings / 2 / (part.length / sampleRate);
          };
          // Every second begins and ends in silence.
          let [least, quietest] = [0.1, null];
          for (let at = 0; at + 48 < samples.length; at += 12) {
            const level = samples.subarray(at, at + 48).reduce((most, value) => Math.max(most, Math.abs(value)), 0);
            if (level < least) [least, quietest] = [level, (at + 24) / sampleRate];
          }
          const second = (from) => Math.round((hertz(from) - lowest) / step);
          const media = quietest === null ? null : quietest < 0.25 ? second(quietest + 0.02) - quietest : second(quietest - 0.22) + 1 - quietest;
          return { when, rate, channels, stopped, second: second(0.05), media };
        }),
    [first, FIRST_TONE, STEP],
  );

/** How far pictures are from the sound that is heard at the same time, in seconds, in pieces that tell their place. */
async function apart(page) {
  const pieces = await piecesOf(page);
  const places = await page.evaluate(() => globalThis.heard.places);
  return places.flatMap(([time, shown]) => {
    const piece = pieces.findLast(({ when, rate, stopped }) => when <= time && time < when + 0.5 / rate && time < stopped);
    return piece === undefined || piece.media === null ? [] : [shown - (piece.media + (time - piece.when) * piece.rate)];
  });
}

test("sound and pictures go together, and a click begins both", async () => {
  const page = await opened();
  // A piece then has a second's end within it.
  await page.evaluate(() => (document.querySelector("decogs-player").currentFrame = 8));
  await until(page, "player.info.frame === 8 && !player.seeking");
  await page.click(".play");
  await until(page, "player.currentTime > 4");
  const pieces = await piecesOf(page);
  assert.ok(pieces.length >= 8, `${pieces.length} pieces`);
  assert.ok(pieces.every(({ channels }) => channels === 2));
  // Pieces follow each other to the sample, unless a busy machine has let pictures fall behind, when sound begins anew.
  const off = pieces.slice(1).map(({ when }, at) => Math.abs(when - pieces[at].when - 0.5));
  assert.ok(off.filter((each) => each < 1e-6).length >= 4, `they are off by ${off.join(", ")}`);
  assert.ok(off.every((each) => each < 1e-6 || each > 1e-3), `they are off by ${off.join(", ")}`);
  const distances = await apart(page);
  assert.ok(distances.length > 10, `${distances.length} places`);
  const most = Math.max(...distances.map(Math.abs));
  console.log(`pictures are up to ${(1000 * most).toFixed(1)} ms from the sound`);
  // What the player lets them be apart, and how exactly a busy page can be asked.
  assert.ok(most < 0.06 + FRAME, `pictures are up to ${most.toFixed(3)} s from the sound`);
  assert.deepEqual(page.complaints, []);
  await page.context().close();
});

test("sound begins with its first sample, and goes on from one pass of a loop to the next without a gap", async () => {
  const page = await opened("&range=0:20");
  await page.click(".play");
  // Two pieces a pass, of 15 frames and of 5.
  await until(page, "globalThis.heard.sources.length > 12");
  const pieces = await page.evaluate(() => globalThis.heard.sources.map(({ when, offset, length, stopped }) => ({ when, offset, length, stopped })));
  assert.equal(pieces[0].offset, 0);
  // A busy machine may have let pictures fall behind, when sound begins anew.
  const meets = pieces.slice(1).filter(({ when, offset }, at) => offset === 0 && Math.abs(when - pieces[at].when - pieces[at].length / 48_000) < 1e-6 && pieces[at].stopped === Infinity);
  assert.ok(meets.length >= 6, JSON.stringify(pieces));
  assert.deepEqual(page.complaints, []);
  await page.context().close();
});

test("without a touch of anybody's, pictures play alone, until there is one", async () => {
  const page = await opened();
  await page.evaluate(() => void document.querySelector("decogs-player").play());
  await until(page, "player.currentTime > 0.5");
  assert.equal(await page.evaluate(() => globalThis.heard.context.state), "suspended");
  assert.deepEqual(await piecesOf(page), []);
  await page.mouse.click(5, 5);
  await until(page, "globalThis.heard.sources.length > 1");
  await page.context().close();
});

test("a seek, another speed, and silence at a pause", async () => {
  const page = await opened();
  await page.click(".play");
  await until(page, "globalThis.heard.sources.length > 2");
  const before = await page.evaluate(() => {
    const player = document.querySelector("decogs-player");
    player.currentTime = 6 + 8 / 30;
    return globalThis.heard.sources.length;
  });
  await until(page, `globalThis.heard.sources.length > ${before + 2}`);
  const sought = await piecesOf(page, before);
  assert.equal(sought[0].second, 6);
  const now = await page.evaluate(() => {
    document.querySelector("decogs-player").playbackRate = 0.5;
    return globalThis.heard.sources.length;
  });
  await until(page, `globalThis.heard.sources.length > ${now + 2}`);
  assert.ok((await piecesOf(page, now)).some(({ rate }) => rate === 0.5));
  await page.evaluate(() => document.querySelector("decogs-player").pause());
  const { sources, time } = await page.evaluate(() => ({ sources: globalThis.heard.sources.map(({ when, stopped, rate }) => ({ end: Math.min(when + 0.5 / rate, stopped) })), time: globalThis.heard.context.currentTime }));
  assert.ok(sources.every(({ end }) => end <= time + 1e-6), "something sounds on");
  await page.context().close();
});

test("volume and mute, by the bar, by keys and by the page", async () => {
  const page = await opened();
  const told = () => page.evaluate(() => { const { muted, volume } = document.querySelector("decogs-player"); return [muted, volume]; });
  assert.deepEqual(await told(), [false, 1]);
  await page.click("[name=mute]");
  assert.deepEqual(await told(), [true, 1]);
  await page.keyboard.press("m");
  assert.deepEqual(await told(), [false, 1]);
  const events = await page.evaluate(() => {
    const player = document.querySelector("decogs-player");
    let count = 0;
    player.addEventListener("volumechange", () => count++);
    player.volume = 0.25;
    player.muted = true;
    return count;
  });
  assert.equal(events, 2);
  await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
  assert.equal(await page.evaluate(() => document.querySelector("decogs-player").shadowRoot.querySelector("[name=volume]").value), "0");
  await page.context().close();
});

test("sound with a place is heard from there, where the transform has it, by whoever looks", async () => {
  const page = await browser.opened("placed", { width: 480, height: 270 });
  await page.addInitScript(() => {
    const Real = PannerNode;
    globalThis.panners = [];
    globalThis.PannerNode = class extends Real {
      constructor(context, options) {
        super(context, options);
        globalThis.panners.push(this);
      }
    };
  });
  await page.reload();
  await ready(page);
  await until(page, "globalThis.panners.length === 1");
  const told = await page.evaluate(async () => {
    const player = document.querySelector("decogs-player");
    await player.play();
    await new Promise((done) => player.addEventListener("timeupdate", done, { once: true }));
    const [panner] = globalThis.panners;
    const { listener } = panner.context;
    // Set with a picture, and read as the sound's own thread has it.
    for (let pictures = 0; pictures < 300 && listener.positionX.value === 0; pictures++) await new Promise(requestAnimationFrame);
    const three = (of, name) => ["X", "Y", "Z"].map((axis) => of[`${name}${axis}`].value);
    const { centre, axes } = player.view.pose;
    return { panner: three(panner, "position"), reference: panner.refDistance, position: three(listener, "position"), forward: three(listener, "forward"), centre, looks: axes[2], first: player.header.cameras[0].worldToCamera };
  });
  // s R x + t of the stream's presentation, tests/player/browser_data.py.
  const [x, y, z] = [0.5, 0.25, 2];
  const rows = [[1.915111107797445, -1.456408540173963, 0.679134455685461, 3], [1.606969024216348, 1.73568011003721, -0.809360927417662, -20], [0, 1.056545654351749, 2.265769467591625, 0.5]];
  const near = (found, wanted) => found.forEach((value, axis) => assert.ok(Math.abs(value - wanted[axis]) < 1e-4, `${found} for ${wanted}`));
  near(told.panner, rows.map((row) => row[0] * x + row[1] * y + row[2] * z + row[3]));
  near(told.position, told.centre);
  near(told.forward, told.looks);
  const centre = [0, 1, 2].map((axis) => -told.first.reduce((sum, row) => sum + row[axis] * row[3], 0));
  near([told.reference], [Math.hypot(...centre.map((value, axis) => value - told.panner[axis]))]);
  await page.context().close();
});

test("a stream without sound has no controls of it, and its script does not come", async () => {
  const page = await browser.opened("long");
  await ready(page);
  await until(page, "player.shadowRoot.querySelector('.bar') !== null");
  assert.equal(await page.evaluate(() => document.querySelector("decogs-player").shadowRoot.querySelector(".sound").hidden), true);
  const loaded = await page.evaluate(() => performance.getEntriesByType("resource").map(({ name }) => name));
  assert.ok(!loaded.some((name) => name.includes("decogs-sound")));
  await page.context().close();
});

test("a stream that grows sounds on without a hole", async () => {
  const whole = readFileSync(join(DATA, "tones.dgs"));
  const path = join(folder, "tones.dgs");
  writeFileSync(path, whole.subarray(0, Math.round(0.1 * whole.length)));
  const page = await browser.opened("tones", { folder: "growing", query: "&follow", width: 480, height: 270 });
  await page.addInitScript(listening);
  await page.reload();
  await ready(page);
  await until(page, "globalThis.heard.context !== null && player.shadowRoot.querySelector('.bar') !== null");
  await page.click(".play");
  // As fast as it plays, so that the newest frame is always soon due.
  let before = 0;
  for (let part = 2; part < 20; part++) {
    if (part === 19) before = await page.evaluate(() => globalThis.heard.sources.length);
    appendFileSync(path, whole.subarray(Math.round((part / 20) * whole.length), Math.round(((part + 1) / 20) * whole.length)));
    await new Promise((done) => setTimeout(done, 500));
  }
  await until(page, "player.ended", 60_000);
  // Those from before the stream's end was there: the last frame of all has a block less, and is put on the clock twice where sound begins anew.
  const holes = await page.evaluate((before) =>
    globalThis.heard.sources.slice(0, before).map(({ samples }) => {
      let longest = 0;
      for (let at = 0, silent = 0; at < samples.length; at++) longest = Math.max(longest, (silent = samples[at] === 0 ? silent + 1 : 0));
      return longest;
    }), before,
  );
  assert.ok(holes.length >= 5, `${holes.length} pieces`);
  assert.ok(Math.max(...holes) < 100, `${Math.max(...holes)} samples of silence`);
  await page.context().close();
});

test("sound in Firefox", { skip: firefoxPath === undefined ? "Firefox is not installed" : false }, async () => {
  const server = await served({ page: process.env.DECOGS_PAGE, data: DATA });
  const other = await firefox();
  try {
    await other.go(`${server.address}/page/index.html?src=/data/tones.dgs`);
    const told = await other.evaluate(async () => {
      const player = document.querySelector("decogs-player");
      const heard = [];
      const { start } = AudioBufferSourceNode.prototype;
      AudioBufferSourceNode.prototype.start = function (when, offset) {
        heard.push({ when: when - offset, samples: this.buffer.getChannelData(0) });
        start.call(this, when, offset);
      };
      // Firefox without a sound card never starts a context.
      const begun = performance.now();
      globalThis.AudioContext = class extends AudioContext {
        get state() {
          return "running";
        }
        get currentTime() {
          return (performance.now() - begun) / 1000;
        }
      };
      player.load();
      while (player.info === null || player.readyState < 3) await new Promise((done) => setTimeout(done, 50));
      player.currentTime = 3;
      await player.play();
      // A machine that has much else to do may have sound begin anew.
      const meet = () => heard.some(({ when }, at) => at > 0 && Math.abs(when - heard[at - 1].when - 0.5) < 1e-6);
      for (let tries = 0; !meet() && tries < 200; tries++) await new Promise((done) => setTimeout(done, 50));
      player.pause();
      const part = heard[0].samples.subarray(2400, 12_000);
      let crossings = 0;
      for (let at = 1; at < part.length; at++) crossings += part[at - 1] < 0 !== part[at] < 0 ? 1 : 0;
      return { hertz: crossings / 2 / (part.length / 48_000), meet: meet() };
    });
    assert.equal(Math.round((told.hertz - FIRST_TONE) / STEP), 3);
    assert.equal(told.meet, true);
  } finally {
    await other.close();
    await server.close();
  }
});
