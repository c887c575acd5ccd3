// How a stream wants to be shown (SPEC section 4): title, poster frame, first view, and
// its frame as a file. The picture of the transform is compared in pictures.test.mjs.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { after, before, test } from "node:test";
import { started, until } from "./harness.mjs";

let browser;
before(async () => (browser = await started()));
after(() => browser.close());

test("the page has the stream's title, its first view, and its poster frame until it plays", async () => {
  const page = await browser.opened("shown0");
  await until(page, "player.info?.frame === 2");
  assert.equal(await page.title(), "Three <cameras> & a ball - decogs");
  const told = await page.evaluate(() => {
    const { camera, currentFrame, currentTime, paused } = document.querySelector("decogs-player");
    return { camera, currentFrame, currentTime, paused };
  });
  assert.deepEqual(told, { camera: "off centre", currentFrame: 0, currentTime: 0, paused: true });
  const first = await page.evaluate(async () => {
    const player = document.querySelector("decogs-player");
    const shown = new Promise((done) => player.addEventListener("seeked", () => done(player.info.frame), { once: true }));
    await player.play();
    return shown;
  });
  assert.equal(first, 0);
  assert.deepEqual(page.complaints, []);
  await page.context().close();
});

test("a frame or camera that was asked for comes before those", async () => {
  const page = await browser.opened("shown0", { query: "&camera=turned#frame=1" });
  await until(page, "player.info?.frame === 1 && player.camera === 'turned'");
  await page.context().close();
});

test("the menu saves the frame as .ply", async () => {
  const page = await browser.opened("degree2", { width: 640, height: 400 });
  await until(page, "player.info !== null && player.shadowRoot.querySelector('[name=ply]') !== null");
  await page.evaluate(() => (document.querySelector("decogs-player").currentFrame = 2));
  await until(page, "player.info.frame === 2");
  await page.locator("[name=menu]").click();
  const [download] = await Promise.all([page.waitForEvent("download"), page.locator("[name=ply]").click()]);
  assert.equal(download.suggestedFilename(), "frame_0002.ply");
  const text = readFileSync(await download.path(), "latin1");
  assert.match(text, /^ply\nformat binary_little_endian 1.0\n(.*\n)*element vertex 1506\n/);
  await page.context().close();
});
