/** Draws a box or sphere over the scene, and says the command that keeps what lies in it. A script of its own. */
import { adopt } from "../adopted_style";
import { lookedAt } from "../camera/looked_at";
import { poseOf } from "../geometry/poses";
import type { PlayerApi } from "../player_api";
import { ownMarkup } from "../trusted";
import { cropCommand, drawnRegion, outlines, type Point, type Region } from "./region";
import style from "./crop.css";

const MARKUP = `
<canvas></canvas>
<div class="panel tool" role="group" aria-label="Crop">
  <label>Keep a <select name="shape"><option value="box">box</option><option value="sphere">sphere</option></select></label>
  <button type="button" name="draw" aria-pressed="true">Draw</button>
  <button type="button" name="copy" disabled>Copy</button>
  <button type="button" name="done">Done</button>
  <output>Drag over what is to stay. Then look from beside, and draw again.</output>
</div>`;

export class CropTool {
  private readonly holder = document.createElement("div");
  private readonly canvas: HTMLCanvasElement;
  private region: Region | null = null;
  private from: Point | null = null;

  constructor(
    private readonly player: PlayerApi,
    root: ShadowRoot,
  ) {
    this.holder.className = "crop";
    this.holder.innerHTML = ownMarkup(MARKUP, "decogs-crop");
    adopt(root, style);
    root.querySelector(".controls")!.before(this.holder);
    this.canvas = this.part("canvas") as HTMLCanvasElement;
    this.canvas.addEventListener("pointerdown", (event) => {
      this.canvas.setPointerCapture(event.pointerId);
      this.from = [event.offsetX, event.offsetY];
    });
    this.canvas.addEventListener("pointermove", (event) => {
      this.draw([event.offsetX, event.offsetY]);
    });
    this.canvas.addEventListener("pointerup", (event) => {
      this.draw([event.offsetX, event.offsetY]);
      this.from = null;
      this.drawing = this.region === null;
    });
    this.part("[name=shape]").addEventListener("change", () => {
      this.region = null;
      this.drawing = true;
      this.refresh();
    });
    this.part("[name=draw]").addEventListener("click", () => {
      this.drawing = !this.drawing;
    });
    this.part("[name=copy]").addEventListener("click", () => void navigator.clipboard.writeText(this.part("output").textContent));
    this.part("[name=done]").addEventListener("click", () => {
      this.holder.hidden = true;
      player.focus();
    });
    this.open();
  }

  open(): void {
    this.holder.hidden = false;
    this.drawing = true;
    this.refresh();
  }

  /** Draws the region as the camera sees it now. */
  refresh(): void {
    const { player, canvas, region } = this;
    const camera = this.holder.hidden ? null : player.currentCamera(player.clientWidth, player.clientHeight);
    if (camera === null) return;
    Object.assign(canvas, { width: camera.width, height: camera.height });
    if (region === null) return;
    const context = canvas.getContext("2d")!;
    for (const [colour, width] of [["#000", 3], ["#ffb45e", 1.5]] as const) {
      [context.strokeStyle, context.lineWidth] = [colour, width];
      context.beginPath();
      for (const line of outlines(region, camera)) line.forEach(([x, y], i) => { context[i === 0 ? "moveTo" : "lineTo"](x, y); });
      context.stroke();
    }
  }

  /** Whether dragging draws; else it moves the camera. */
  private set drawing(on: boolean) {
    this.part("[name=draw]").setAttribute("aria-pressed", String(on));
    this.canvas.classList.toggle("drawing", on);
  }
  private get drawing(): boolean {
    return this.canvas.classList.contains("drawing");
  }

  private draw(to: Point): void {
    const { player, from } = this;
    const camera = player.currentCamera(player.clientWidth, player.clientHeight);
    if (from === null || camera === null || player.header === null || Math.hypot(to[0] - from[0], to[1] - from[1]) < 4) return;
    const kind = (this.part("[name=shape]") as HTMLSelectElement).value as Region["kind"];
    const around = lookedAt(player.header.cameras.map(poseOf));
    this.region = drawnRegion(kind, camera, around, from, to, this.region);
    const name = decodeURIComponent(player.getAttribute("src")?.split(/[?#]/)[0].split("/").pop() ?? "") || "scene.dgs";
    this.part("output").textContent = cropCommand(this.region, name);
    (this.part("[name=copy]") as HTMLButtonElement).disabled = false;
    this.refresh();
  }

  private part(selector: string): HTMLElement {
    return this.holder.querySelector<HTMLElement>(selector)!;
  }
}
