// Takes exact pictures of a page in Chromium: node exact.mjs URL FOLDER CAMERA:FRAME ...
// With WebGL2 by the switch, then without WebGL2; prints what the page told as JSON.
import { writeFileSync } from "node:fs";
import { join } from "node:path";
import { chromiumPath, launched } from "./chromium.mjs";

const [url, folder, ...wanted] = process.argv.slice(2);
if (chromiumPath === undefined) process.exit(3);
const problems = [];
const told = {};
for (const without of [false, true]) {
  const browser = await launched();
  const page = await browser.newPage({ viewport: { width: 480, height: 300 } });
  page.on("console", (message) => problems.push(message.text()));
  page.on("pageerror", (error) => problems.push(error.message));
  if (without) {
    await page.addInitScript(() => {
      const given = HTMLCanvasElement.prototype.getContext;
      HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
        return kind.startsWith("webgl") ? null : given.call(this, kind, ...more);
      };
    });
  }
  await page.goto(url);
  await page.waitForFunction(() => document.querySelector("decogs-player").info !== null);
  for (const [camera, frame] of wanted.map((each) => each.split(":"))) {
    const picture = await page.evaluate(
      async ([camera, frame]) => {
        const player = document.querySelector("decogs-player");
        const index = player.header.cameras.findIndex(({ name }) => name === camera);
        const { width, height } = player.header.cameras[index];
        player.exact = true;
        player.lookThrough(index, true);
        if (player.info.frame !== frame) {
          const seeked = new Promise((done) => player.addEventListener("seeked", done, { once: true }));
          player.currentFrame = frame;
          await seeked;
        }
        const bytes = new Uint8Array(await (await player.capture(width, height)).arrayBuffer());
        return btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));
      },
      [camera, Number(frame)],
    );
    writeFileSync(join(folder, `${without ? "without" : "with"}_${camera}_${frame}.png`), Buffer.from(picture, "base64"));
  }
  told[without ? "without" : "with"] = await page.evaluate(() => {
    const { exact, canChooseExact, error } = document.querySelector("decogs-player");
    return { exact, canChooseExact, error };
  });
  await browser.close();
}
console.log(JSON.stringify({ ...told, problems }));
