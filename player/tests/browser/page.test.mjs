// The element in a page that others wrote: moved about, under a strict policy, opened from the disk, in small places.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { picture, psnr, ready, show, started, until } from "./harness.mjs";

let browser;
before(async () => (browser = await started()));
after(() => browser.close());

/** Looks from beside, so that a view that was forgotten shows. */
const lookAside = (page) =>
  page.evaluate(() => {
    const player = document.querySelector("decogs-player");
    const { worldToCamera: rows, ...lens } = player.currentCamera(200, 150);
    player.lookFrom({ axes: rows.map((row) => row.slice(0, 3)), centre: [0.3, 0.1, -0.2] }, lens);
  });

for (const [how, move] of [
  ["moved to another place", () => {
    const place = document.createElement("div");
    document.body.append(place);
    place.append(document.querySelector("decogs-player"));
  }],
  ["taken out and put in again later", async () => {
    const player = document.querySelector("decogs-player");
    player.remove();
    await new Promise((done) => setTimeout(done, 100));
    document.body.append(player);
  }],
]) {
  test(`an element that is ${how} keeps frame, camera and picture`, async () => {
    const page = await browser.opened("long");
    await ready(page);
    await show(page, 61);
    await lookAside(page);
    await until(page, "!inside.stage.pending && !inside.stage.renderer.busy");
    const before = await picture(page, 200, 150);
    await page.evaluate(move);
    await until(page, "player.info?.frame === 61 && !inside.stage.pending && !inside.stage.renderer.busy");
    assert.ok(psnr(await picture(page, 200, 150), before) > 60);
    assert.equal(await page.evaluate(() => document.querySelector("decogs-player").camera), "");
    await show(page, 62);
    assert.deepEqual(page.complaints, []);
    await page.context().close();
  });
}

test("an element that is moved while it plays goes on, and begins anew with another stream", async () => {
  const page = await browser.opened("long", { query: "&loop" });
  await ready(page);
  const told = await page.evaluate(async () => {
    const player = document.querySelector("decogs-player");
    const next = (name) => new Promise((done) => player.addEventListener(name, done, { once: true }));
    await player.play();
    document.body.prepend(player);
    const { paused, error } = player;
    player.remove();
    player.src = "/data/degree1.dgs";
    document.body.append(player);
    await next("loadeddata");
    return [paused, error, player.frames.count, player.info.frame];
  });
  assert.deepEqual(told.slice(0, 2), [false, null]);
  assert.equal(told[3], 0);
  await page.context().close();
});
