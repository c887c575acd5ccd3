// Plays a page that somebody else's bundler made: node packaged.mjs FOLDER_OR_ADDRESS; prints what came of it as JSON: as the player
// chooses where WebGL2 is software, by WebGL2, and without any. A folder's page has the policy that README.md states.
import { readFileSync, readdirSync } from "node:fs";
import { join } from "node:path";
import { chromiumPath, launched } from "./chromium.mjs";
import { pixelsOf } from "./harness.mjs";
import { served } from "./server.mjs";

if (chromiumPath === undefined) process.exit(3);
const [given] = process.argv.slice(2);
const subfolders = given.startsWith("http") ? [] : readdirSync(given, { withFileTypes: true }).filter((entry) => entry.isDirectory());
const [, policy] = /^```\n(default-src .*)\n```$/m.exec(readFileSync(new URL("../../README.md", import.meta.url), "utf8"));
const folders = { app: given, ...Object.fromEntries(subfolders.map(({ name }) => [name, join(given, name)])) };
const server = await served(folders, { ranges: true, headers: { "content-security-policy": policy } });
const address = given.startsWith("http") ? given : `${server.address}/app/index.html`;

/** So many colours are in a picture of the screen. */
async function colours(page) {
  const shot = await page.locator("decogs-player").screenshot();
  const { data } = await pixelsOf(page, `data:image/png;base64,${shot.toString("base64")}`);
  return new Set(new Uint32Array(data.buffer, data.byteOffset, data.length / 4)).size;
}

const told = {};
for (const [name, exact, webgl] of [["chosen", null, true], ["webgl2", "off", true], ["no webgl", null, false]]) {
  const browser = await launched(webgl);
  const page = await browser.newPage({ viewport: { width: 320, height: 400 } });
  const complaints = [];
  page.on("console", (message) => message.type() === "error" && complaints.push(message.text()));
  page.on("pageerror", (error) => complaints.push(String(error)));
  // A stream's bytes that are not needed after all are given up.
  page.on("requestfailed", (request) => request.failure().errorText === "net::ERR_ABORTED" || complaints.push(`${request.url()} failed`));
  page.on("response", (response) => response.status() >= 400 && complaints.push(`${response.url()}: HTTP ${response.status()}`));
  await page.goto(`${address}?exact=${exact ?? ""}`);
  await page.waitForFunction(() => {
    const player = document.querySelector("decogs-player");
    return player.error || (player.figures?.pictures > 0 && player.shadowRoot.querySelector(".bar"));
  });
  await page.waitForFunction(() => globalThis.decoded !== undefined);
  if (webgl) await page.waitForFunction(() => globalThis.inScene.error ?? globalThis.inScene.info);
  await page.waitForTimeout(500);
  told[name] = await page.evaluate(() => {
    const { exact, error, info } = document.querySelector("decogs-player");
    const { decoded } = globalThis;
    return { frame: info?.frame, exact, error, decoded, inScene: globalThis.inScene && (globalThis.inScene.error ?? globalThis.inScene.info.frame) };
  });
  Object.assign(told[name], { drawn: (await colours(page)) > 500, complaints });
  await browser.close();
}
console.log(JSON.stringify(told));
await server.close();
