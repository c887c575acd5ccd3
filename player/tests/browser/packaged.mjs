// Plays a page that somebody else's bundler made: node packaged.mjs FOLDER; prints what came of it as JSON.
import { chromiumPath, launched } from "./chromium.mjs";
import { served } from "./server.mjs";

if (chromiumPath === undefined) process.exit(3);
const server = await served({ app: process.argv[2], assets: `${process.argv[2]}/assets`, "scene.dgs": `${process.argv[2]}/scene.dgs` });
const browser = await launched();
const page = await browser.newPage();
const complaints = [];
page.on("console", (message) => message.type() === "error" && complaints.push(message.text()));
page.on("pageerror", (error) => complaints.push(String(error)));
await page.goto(`${server.address}/app/index.html`);
await page.waitForFunction(() => {
  const player = document.querySelector("decogs-player");
  const { error, info } = globalThis.inScene ?? {};
  if (error == null && info == null) return false;
  return player.error !== null || (player.info !== null && player.shadowRoot.querySelector(".bar") !== null);
});
const told = await page.evaluate(async () => {
  const player = document.querySelector("decogs-player");
  player.exact = true;
  await player.capture(64, 48); // by the kernel, which is a file of its own
  return { frame: player.info.frame, exact: player.exact, controls: player.shadowRoot.querySelector(".bar") !== null, error: player.error, inScene: globalThis.inScene.info?.frame ?? globalThis.inScene.error };
});
console.log(JSON.stringify({ ...told, complaints }));
await browser.close();
await server.close();
