// The first picture: who begins early, and that it comes to the same.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { filed, listed, picture, psnr, ready, started, until } from "./harness.mjs";

let browser;
before(async () => (browser = await started()));
after(() => browser.close());
const { pictures } = listed();

test("the page's early worker is the one that plays, and reads the beginning once", async () => {
  browser.server.requests.length = 0;
  const page = await browser.opened("long");
  await ready(page);
  const of = (name) => browser.server.requests.filter(({ path }) => path.endsWith(name));
  assert.equal(of("decogs-worker.js").length, 1);
  assert.equal(of("decogs-zstd.wasm").length, 1);
  assert.equal(of("long.dgs").filter(({ range }) => range?.startsWith("bytes=0-")).length, 1);
  assert.equal(await page.evaluate(() => globalThis.decogsEarly), undefined);
  assert.equal(page.workers().length, 1);
  assert.deepEqual(page.complaints, []);
  await page.context().close();
});

test("a link to a frame begins with that frame", async () => {
  const page = await browser.opened("long", { query: "#frame=130" });
  await ready(page);
  await until(page, "player.info.frame === 130");
  const { file } = pictures.find(({ stream, frame }) => stream === "long" && frame === 130);
  assert.ok(psnr(await picture(page, 200, 150), await filed(page, file)) >= 40);
  await page.context().close();
});

test("a link to a frame that does not exist begins with the last", async () => {
  const page = await browser.opened("degree1", { query: "#frame=1000" });
  await ready(page);
  await until(page, "player.info.frame === 3 && player.error === null");
  await page.context().close();
});

test("a page of one's own, another stream after the first, and two players", async () => {
  const page = await browser.opened("arc");
  await ready(page);
  const told = await page.evaluate(async () => {
    const player = document.querySelector("decogs-player");
    const next = (of, name) => new Promise((done) => of.addEventListener(name, done, { once: true }));
    player.src = "/data/degree1.dgs";
    await next(player, "loadeddata");
    const second = document.createElement("decogs-player");
    second.src = "/data/dome.dgs";
    document.body.append(second);
    await next(second, "loadeddata");
    return [player.header.shDegree, second.info.frame, player.error, second.error];
  });
  assert.deepEqual(told, [1, 0, null, null]);
  const { file } = pictures.find(({ stream, camera }) => stream === "degree1" && camera === "cam00");
  await page.evaluate(() => (document.querySelector("decogs-player").currentFrame = 3));
  await until(page, "player.info.frame === 3");
  assert.ok(psnr(await picture(page, 200, 150), await filed(page, file)) >= 40);
  await page.context().close();
});
