/**
 * What a rig camera recorded, over its view: a line divides the two, and one drags it. The server that has the rig tells
 * where the pictures lie by the attribute `recordings`, a template such as "./recorded/{camera}/{frame}.jpg".
 */
import type { PlayerApi } from "../player_api";

const STEP = 0.05;

export class Comparison {
  private readonly picture = new Image();
  private loading = false;
  private shown = "";
  private wanted = "";
  /** Whose picture it is; that of another camera is not left over this one's view until its own has come. */
  private camera = "";
  private loaded = false;
  /** Where the line is, as a share of the camera's picture; what was recorded lies left of it. */
  private share = 0.5;

  constructor(
    private readonly player: PlayerApi,
    private readonly holder: HTMLElement,
    private readonly line: HTMLElement,
  ) {
    this.picture.alt = "What the camera recorded";
    this.picture.draggable = false;
    holder.prepend(this.picture);
    this.picture.addEventListener("load", () => {
      this.arrived(true);
    });
    this.picture.addEventListener("error", () => {
      this.arrived(false);
    });
    line.addEventListener("pointerdown", (event) => {
      line.setPointerCapture(event.pointerId);
      event.preventDefault();
      event.stopPropagation();
    });
    line.addEventListener("pointermove", (event) => {
      if (!line.hasPointerCapture(event.pointerId)) return;
      const { left, width } = this.picture.getBoundingClientRect();
      this.moveTo((event.clientX - left) / width);
    });
    line.addEventListener("keydown", (event) => {
      if (event.key !== "ArrowLeft" && event.key !== "ArrowRight") return;
      this.moveTo(this.share + (event.key === "ArrowLeft" ? -STEP : STEP));
      event.preventDefault();
      event.stopPropagation();
    });
  }

  /** Brings it in step with the player's camera, frame and size. */
  refresh(): void {
    const { player, holder } = this;
    const area = player.comparing ? player.recordedPlace() : null;
    this.wanted = area === null ? "" : player.recordingAddress();
    if (area !== null && player.camera !== this.camera) this.loaded = false;
    this.picture.hidden = !this.loaded;
    holder.hidden = this.wanted === "" || this.shown === "";
    if (area === null || this.wanted === "") return;
    const { left, top, width, height } = area;
    Object.assign(this.picture.style, { left: `${left}px`, top: `${top}px`, width: `${width}px`, height: `${height}px` });
    this.picture.style.clipPath = `inset(0 ${100 * (1 - this.share)}% 0 0)`;
    Object.assign(this.line.style, { left: `${left + this.share * width}px`, top: `${top}px`, height: `${height}px` });
    this.line.setAttribute("aria-valuenow", String(Math.round(100 * this.share)));
    this.load();
  }

  private moveTo(share: number): void {
    this.share = Math.min(1, Math.max(0, share));
    this.refresh();
  }

  /** One at a time: of frames that pass meanwhile only the last is asked for. */
  private load(): void {
    if (this.loading || this.wanted === "" || this.wanted === this.shown) return;
    this.loading = true;
    this.shown = this.wanted;
    this.camera = this.player.camera;
    this.picture.src = this.wanted;
  }

  private arrived(loaded: boolean): void {
    this.loading = false;
    this.loaded = loaded;
    this.refresh();
  }
}
