// Time: playing, seeking both ways, growing, cut and damaged streams, servers without ranges, memory, a lost context.
import assert from "node:assert/strict";
import { mkdtempSync, readFileSync, rmSync, writeFileSync, appendFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { DATA, filed, listed, picture, pixelsOf, psnr, ready, show, started, until } from "./harness.mjs";

let browser;
const folder = mkdtempSync(join(tmpdir(), "decogs-growing-"));
before(async () => (browser = await started({ growing: folder })));
after(async () => {
  await browser.close();
  rmSync(folder, { recursive: true, force: true });
});
const { ends, pictures } = listed();
const expected = (frame) => pictures.find(({ stream, frame: of }) => stream === "long" && of === frame).file;

async function agrees(page, frame) {
  const decibels = psnr(await picture(page, 200, 150), await filed(page, expected(frame)));
  assert.ok(decibels >= 40, `frame ${frame}: ${decibels.toFixed(2)} dB`);
}

for (const ranges of [true, false]) {
  test(`seeking both ways, from a server ${ranges ? "with" : "without"} ranges`, async () => {
    browser.server.options.ranges = ranges;
    const page = await browser.opened("long");
    await ready(page);
    for (const frame of [299, 61, 130, 7, 0]) {
      await show(page, frame);
      await agrees(page, frame);
    }
    browser.server.options.ranges = true;
    await page.context().close();
  });
}

test("a range of frames is played again and again", async () => {
  const page = await browser.opened("long", { query: "&range=5:9" });
  await ready(page);
  const frames = await page.evaluate(async () => {
    const player = document.querySelector("decogs-player");
    player.currentFrame = 5;
    const seen = [];
    await new Promise((done) => {
      player.addEventListener("timeupdate", () => {
        seen.push(player.info.frame);
        // Round twice: a later frame comes before an earlier one.
        if (seen.filter((frame, i) => i > 0 && frame < seen[i - 1]).length === 3) done();
      });
      player.play();
    });
    return { seen, paused: player.paused, range: player.range };
  });
  assert.deepEqual(frames.range, [5, 9]);
  assert.equal(frames.paused, false);
  const inside = frames.seen.slice(frames.seen.indexOf(5));
  assert.ok(inside.every((frame) => frame >= 5 && frame < 9), `${inside}`);
  await page.evaluate(() => (document.querySelector("decogs-player").range = null));
  await until(page, "player.info.frame > 9");
  for (const wrong of ["9:5", "1", "a:b", "-1:3"]) {
    assert.equal(await page.evaluate((text) => { const player = document.querySelector("decogs-player"); player.setAttribute("range", text); return player.range; }, wrong), null);
  }
  await page.context().close();
});

test("a range that ends behind the last frame is one up to there", async () => {
  const page = await browser.opened("degree1", { query: "&range=2:99" });
  await ready(page);
  await until(page, "inside.playback.complete");
  const seen = await page.evaluate(async () => {
    const player = document.querySelector("decogs-player");
    const seen = [];
    void player.play();
    while (seen.length < 12) {
      await new Promise((done) => player.addEventListener("timeupdate", done, { once: true }));
      seen.push(player.info.frame);
    }
    return seen;
  });
  const inside = seen.slice(seen.indexOf(3));
  assert.ok(inside.every((frame) => frame >= 2), `${inside}`);
  await page.context().close();
});

test("a time that is set before the header has come is where playing begins", async () => {
  const page = await browser.opened("long");
  await ready(page);
  for (const name of ["currentTime", "currentFrame"]) {
    const told = await page.evaluate(async (name) => {
      const player = document.createElement("decogs-player");
      player[name] = name === "currentTime" ? 130.5 / 30 : 130;
      const before = player[name];
      const seeked = new Promise((done) => player.addEventListener("seeked", done, { once: true }));
      const metadata = new Promise((done) =>
        player.addEventListener("loadedmetadata", () => done(Math.floor(player.currentTime * player.fps + 1e-6)), { once: true }),
      );
      player.src = document.querySelector("decogs-player").src;
      document.body.append(player);
      const atMetadata = await metadata;
      await seeked;
      const { frame: shown } = player.info;
      // What was used up does not count for the next stream.
      player.src += "?again";
      const again = player.currentTime;
      await new Promise((done) => player.addEventListener("loadeddata", done, { once: true }));
      const next = player.info.frame;
      player.remove();
      return { before, shown, atMetadata, again, next };
    }, name);
    const before = name === "currentTime" ? 130.5 / 30 : 130;
    assert.deepEqual(told, { before, shown: 130, atMetadata: 130, again: 0, next: 0 });
  }
  await page.context().close();
});

test("events and properties are those of <video>", async () => {
  const page = await browser.opened("degree1", { query: "&loop" });
  await ready(page);
  const told = await page.evaluate(async () => {
    const player = document.querySelector("decogs-player");
    const events = [];
    for (const name of ["play", "pause", "timeupdate", "seeking", "seeked", "ended"]) {
      player.addEventListener(name, () => events.push(name));
    }
    const next = (name) => new Promise((done) => player.addEventListener(name, done, { once: true }));
    const { duration } = player;
    const seeked = next("seeked");
    player.currentTime = 2 / 30;
    await seeked;
    const { currentTime } = player;
    player.loop = false;
    const ended = next("ended");
    player.playbackRate = 0.5;
    await player.play();
    const { paused } = player;
    await ended;
    return { duration, currentTime, paused, ended: player.ended && player.currentTime === duration, pausedAtEnd: player.paused, events, rate: player.playbackRate };
  });
  assert.ok(Math.abs(told.duration - 4 / 30) < 1e-9);
  assert.ok(Math.abs(told.currentTime - 2 / 30) < 1e-9);
  assert.deepEqual([told.paused, told.ended, told.pausedAtEnd, told.rate], [false, true, true, 0.5]);
  assert.deepEqual(told.events.slice(0, 3), ["seeking", "timeupdate", "seeked"]);
  assert.deepEqual(told.events.filter((name) => name === "play" || name === "ended"), ["play", "ended"]);
  await page.context().close();
});

test("a growing file is followed to its end", async () => {
  const whole = readFileSync(join(DATA, "long.dgs"));
  const path = join(folder, "long.dgs");
  writeFileSync(path, whole.subarray(0, ends[9] + 30));
  const page = await browser.opened("long", { folder: "growing", query: "&follow" });
  await until(page, "player.frames.count === 10");
  await show(page, 9);
  assert.equal(await page.evaluate(() => document.querySelector("decogs-player").error), null);
  appendFileSync(path, whole.subarray(ends[9] + 30, ends[64]));
  await until(page, "player.frames.count === 65");
  await show(page, 61);
  await agrees(page, 61);
  appendFileSync(path, whole.subarray(ends[64]));
  await until(page, "player.frames.count === 300 && inside.playback.complete");
  await show(page, 299);
  await agrees(page, 299);
  await page.context().close();
});

test("a stream that is cut off shows what is there and says so", async () => {
  const page = await browser.opened("cut");
  await ready(page);
  await until(page, "player.frames.count === 101");
  await show(page, 100);
  await show(page, 61);
  await agrees(page, 61);
  await until(page, "!player.shadowRoot.querySelector('.notice').hidden");
  const notice = await page.evaluate(() => document.querySelector("decogs-player").shadowRoot.querySelector(".notice").textContent);
  assert.match(notice, /truncated/);
  await page.evaluate(() => document.querySelector("decogs-player").play());
  await until(page, "player.ended");
  await page.context().close();
});

test("a damaged frame shows the last good one and says so, until the next keyframe", async () => {
  const page = await browser.opened("damaged");
  await ready(page);
  await show(page, 75);
  const damage = await page.evaluate(() => document.querySelector("decogs-player").info.damage);
  assert.match(damage, /bad-payload-crc/);
  await show(page, 130);
  assert.equal(await page.evaluate(() => document.querySelector("decogs-player").info.damage), null);
  await agrees(page, 130);
  await page.context().close();
});

test("what is no stream is an error that says so", async () => {
  const page = await browser.opened("missing");
  await until(page, "player.error !== null");
  writeFileSync(join(folder, "other.dgs"), "<html>no stream</html>".repeat(20));
  const other = await browser.opened("other", { folder: "growing" });
  await until(other, "player.error !== null");
  assert.match(await other.evaluate(() => document.querySelector("decogs-player").error), /growing\/other\.dgs.*not a \.dgs stream/);
  // One that ends inside its first keyframe.
  writeFileSync(join(folder, "begun.dgs"), readFileSync(join(DATA, "long.dgs")).subarray(0, ends[0] - 100));
  const begun = await browser.opened("begun", { folder: "growing" });
  await until(begun, "player.error !== null");
  assert.match(await begun.evaluate(() => document.querySelector("decogs-player").error), /cut off/);
  await until(begun, "player.shadowRoot.querySelector('.veil')?.hidden");
  for (const each of [page, other, begun]) await each.context().close();
});

test("a lost WebGL context comes back with the same picture", async () => {
  const page = await browser.opened("long");
  await ready(page);
  await show(page, 7);
  await page.evaluate(async () => {
    const player = document.querySelector("decogs-player");
    const extension = player[Symbol.for("decogs.inside")].stage.renderer.canvas.getContext("webgl2").getExtension("WEBGL_lose_context");
    extension.loseContext();
    await new Promise((done) => setTimeout(done, 200));
    extension.restoreContext();
    await new Promise((done) => setTimeout(done, 200));
  });
  await until(page, "!inside.stage.pending && !inside.stage.renderer.busy");
  await agrees(page, 7);
  await show(page, 61);
  await agrees(page, 61);
  await page.context().close();
});

test("a picture that is asked for while the WebGL context is lost, or just back, is the whole one", async () => {
  const page = await browser.opened("long");
  await ready(page);
  await show(page, 7);
  const shots = await page.evaluate(async () => {
    const player = document.querySelector("decogs-player");
    const { canvas } = player[Symbol.for("decogs.inside")].stage.renderer;
    const extension = canvas.getContext("webgl2").getExtension("WEBGL_lose_context");
    const next = (name) => new Promise((done) => canvas.addEventListener(name, done, { once: true }));
    const told = async (picture) => `data:image/png;base64,${btoa(Array.from(new Uint8Array(await (await picture).arrayBuffer()), (byte) => String.fromCharCode(byte)).join(""))}`;
    const lost = next("webglcontextlost");
    extension.loseContext();
    await lost;
    const first = told(player.capture(200, 150));
    await new Promise((done) => setTimeout(done, 200));
    const restored = next("webglcontextrestored");
    extension.restoreContext();
    await restored;
    return [await told(player.capture(200, 150)), await first];
  });
  const wanted = await filed(page, expected(7));
  for (const shot of shots) {
    const decibels = psnr(await pixelsOf(page, shot), wanted);
    assert.ok(decibels >= 40, `${decibels.toFixed(1)} dB`);
  }
  await page.context().close();
});

test("three hundred frames take no more memory than sixty", async (context) => {
  const page = await browser.opened("long");
  await ready(page);
  const client = await page.context().newCDPSession(page);
  const system = await browser.browser.newBrowserCDPSession();
  // What the page's objects take, what its arrays take beside them, and what its process and the GPU's have in memory.
  const memory = async () => {
    await client.send("HeapProfiler.collectGarbage");
    for (const worker of page.workers()) await worker.evaluate(() => globalThis.gc?.());
    const { usedSize, backingStorageSize } = await client.send("Runtime.getHeapUsage");
    const { processInfo } = await system.send("SystemInfo.getProcessInfo");
    const resident = processInfo
      .filter(({ type }) => type === "renderer" || type === "GPU")
      .map(({ id }) => Number(readFileSync(`/proc/${id}/statm`, "utf8").split(" ")[1]) * 4096)
      .reduce((sum, bytes) => sum + bytes, 0);
    return [usedSize, backingStorageSize, resident].map((bytes) => Math.round(bytes / 1e5) / 10);
  };
  const playTo = async (frame) => {
    await page.evaluate(() => document.querySelector("decogs-player").play());
    await until(page, `player.info.frame >= ${frame}`, 120_000);
  };
  await playTo(60);
  const early = await memory();
  await playTo(299);
  const late = await memory();
  context.diagnostic(`objects, arrays, processes: ${early.join(", ")} MB after 60 frames, ${late.join(", ")} MB after 300`);
  // Bytes of the stream that were read are kept within a window, which this stream does not fill: .3 MB. An array that is
  // sent with each frame and kept would be 64 kB or more: 15 MB.
  assert.ok(late[0] - early[0] < 3, "objects");
  assert.ok(late[1] - early[1] < 3, "arrays of the page");
  assert.ok(late[2] - early[2] < 12, "processes");
  await page.context().close();
});
