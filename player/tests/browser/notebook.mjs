// Opens a notebook's page in Chromium: node notebook.mjs NOTEBOOK.html [SCREENSHOT.png]; prints what the player in it tells.
import { createServer } from "node:http";
import { readFileSync } from "node:fs";
import { chromiumPath, launched } from "./chromium.mjs";

const [path, screenshot] = process.argv.slice(2);
if (chromiumPath === undefined) process.exit(77);
const server = createServer((_, answer) => answer.writeHead(200, { "content-type": "text/html" }).end(readFileSync(path)));
await new Promise((listening) => server.listen(0, "127.0.0.1", listening));
const browser = await launched();
try {
  const page = await browser.newPage({ viewport: { width: 1000, height: 760 } });
  await page.goto(`http://127.0.0.1:${server.address().port}/`, { waitUntil: "domcontentloaded" });
  const frame = await (await page.waitForSelector("iframe")).contentFrame();
  await frame.waitForFunction(() => document.querySelector("decogs-player")?.info !== null, null, { timeout: 60_000 });
  await frame.waitForFunction(() => !document.querySelector("decogs-player")[Symbol.for("decogs.inside")].stage.pending, null, { timeout: 60_000 });
  if (screenshot !== undefined) await page.screenshot({ path: screenshot });
  const told = await frame.evaluate(() => {
    const { info, error, clientWidth, clientHeight } = document.querySelector("decogs-player");
    return { frame: info.frame, error, clientWidth, clientHeight };
  });
  console.log(JSON.stringify(told));
} finally {
  await browser.close();
  server.close();
}
