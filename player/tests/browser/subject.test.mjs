// A subject lies over the page, or over a colour; a whole scene covers both.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { picture, pixelsOf, psnr, ready, started, until } from "./harness.mjs";

let browser;
before(async () => (browser = await started()));
after(() => browser.close());

const LEAST_DB = 45;

/** What people see of the player, which may be in a frame of the page, without its controls. */
async function seen(page, player = page) {
  await until(player, "player.shadowRoot.querySelector('.controls') !== null");
  await player.evaluate(() => document.querySelector("decogs-player").shadowRoot.querySelector(".controls").remove());
  await until(player, "!inside.stage.pending && !inside.stage.renderer.busy");
  await page.waitForTimeout(200); // until it is on the screen
  return pixelsOf(page, `data:image/png;base64,${(await page.screenshot()).toString("base64")}`);
}

/** The player's picture over one colour. */
async function over(page, colour) {
  const { width, height, data } = await picture(page, 200, 150);
  const mixed = Buffer.alloc(data.length, 255);
  for (let at = 0; at < data.length; at++) {
    if (at % 4 !== 3) mixed[at] = Math.round(colour[at % 4] + ((data[at] - colour[at % 4]) * data[at | 3]) / 255);
  }
  return { width, height, data: mixed };
}

for (const exact of ["", "&exact"]) {
  test(`over the colour that the attribute names${exact}`, async () => {
    const page = await browser.opened("subject", { query: `&background=rgb(230,51,128)${exact}` });
    await ready(page);
    assert.ok(psnr(await seen(page), await over(page, [230, 51, 128])) > LEAST_DB);
    assert.deepEqual(page.complaints, []);
    await page.context().close();
  });

  test(`over the page${exact}`, async () => {
    const page = await browser.opened("subject", { query: exact });
    await ready(page);
    await page.addStyleTag({ content: "body { background: rgb(20,180,90); }" });
    assert.ok(psnr(await seen(page), await over(page, [20, 180, 90])) > LEAST_DB);
    await page.context().close();
  });
}

test("over the page around its frame", async () => {
  const page = await browser.opened("subject");
  await page.evaluate(() => {
    const frame = document.createElement("iframe");
    frame.src = `${location.href}&background=transparent`;
    frame.style.cssText = "position: fixed; inset: 0; border: 0; width: 200px; height: 150px";
    document.documentElement.style.background = "rgb(200,120,10)";
    document.body.replaceChildren(frame);
    document.body.style.background = "none";
  });
  const inner = page.frames()[1];
  await until(inner, "player?.info != null");
  assert.ok(psnr(await seen(page, inner), await over(inner, [200, 120, 10])) > LEAST_DB);
  await page.context().close();
});

test("a whole scene hides what is behind it", async () => {
  const page = await browser.opened("degree1", { query: "&background=lime" });
  await ready(page);
  const { data } = await picture(page, 200, 150);
  for (let at = 3; at < data.length; at += 4) assert.equal(data[at], 255);
  assert.ok(psnr(await seen(page), await over(page, [0, 0, 0])) > LEAST_DB);
  await page.context().close();
});
