// The player in Firefox, where it is installed: without a window it has no WebGL, so that the kernel draws.
import assert from "node:assert/strict";
import { test } from "node:test";
import { firefox, firefoxPath } from "./firefox.mjs";
import { DATA } from "./harness.mjs";
import { served } from "./server.mjs";

test("a stream plays to its end in Firefox, is sought, and told as elsewhere", { skip: firefoxPath === undefined ? "Firefox is not installed" : false }, async () => {
  const server = await served({ page: process.env.DECOGS_PAGE, data: DATA });
  const browser = await firefox();
  try {
    await browser.go(`${server.address}/page/index.html?src=/data/long.dgs`);
    const told = await browser.evaluate(async () => {
      const player = document.querySelector("decogs-player");
      const next = (name) => new Promise((done) => player.addEventListener(name, done, { once: true }));
      if (player.info === null) await next("loadeddata");
      while (player.frames.count < 300 || player.readyState < 4) await next("progress");
      player.currentFrame = 290;
      await next("seeked");
      const { frame } = player.info;
      await player.play();
      await next("ended");
      const picture = await player.capture(200, 150);
      while (player.shadowRoot.querySelector(".bar") === null) await new Promise((done) => setTimeout(done, 50));
      return { frame, last: player.info.frame, time: player.currentTime, exact: player.exact, error: player.error, bytes: picture.size };
    });
    assert.deepEqual({ ...told, bytes: told.bytes > 1000 }, { frame: 290, last: 299, time: 10, exact: true, error: null, bytes: true });
  } finally {
    await browser.close();
    await server.close();
  }
});
