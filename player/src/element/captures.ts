/** What pages take along: the picture in any size, small ones of other frames, the frame's Gaussians, and the recording beside it. */
import { startRecorded } from "../draw/recorded";
import type { PinholeCamera } from "../geometry/camera";
import { intoScene } from "../geometry/similarity";
import type { PlayerApi } from "../player_api";
import type { Pictures } from "./pictures";
import type { Session } from "./session";

export class Captures {
  constructor(
    private readonly player: PlayerApi,
    private readonly session: Pick<Session, "info" | "lost" | "still" | "ply">,
    private readonly pictures: () => Pictures | null,
    private readonly pixelRatio: () => number,
  ) {}

  /** The size of the picture in device pixels. */
  size(): { width: number; height: number } {
    const ratio = this.pixelRatio();
    const { clientWidth, clientHeight } = this.player;
    return { width: Math.max(1, Math.round(clientWidth * ratio)), height: Math.max(1, Math.round(clientHeight * ratio)) };
  }

  camera(width = this.size().width, height = this.size().height): PinholeCamera | null {
    return this.pictures()?.stage.camera(width, height) ?? null;
  }

  async png(width = this.size().width, height = this.size().height): Promise<Blob> {
    const pictures = this.pictures();
    if (pictures === null || this.session.info === null) throw new Error("there is no picture yet");
    if (this.player.recorded) await startRecorded();
    return pictures.stage.capture(width, height, this.session.lost);
  }

  async thumbnail(frame: number, width: number): Promise<ImageData | null> {
    const pictures = this.pictures();
    if (pictures === null || this.session.info === null) return null;
    const { stage } = pictures;
    const { clientWidth, clientHeight } = this.player;
    const camera = stage.camera(width, Math.max(1, Math.round((width * clientHeight) / Math.max(1, clientWidth))));
    const picture = await this.session.still(frame, intoScene({ ...camera, recording: null }, stage.transform));
    return picture && new ImageData(picture.pixels, picture.width, picture.height);
  }

  async ply(): Promise<Blob> {
    if (this.session.info === null) throw new Error("there is no frame yet");
    return new Blob([await this.session.ply()], { type: "application/octet-stream" });
  }

  /** Empty where there is no recording. */
  recordingAddress(): string {
    const { player } = this;
    const template = player.getAttribute("recordings");
    if (template === null || player.camera === "" || this.session.info === null) return "";
    const path = template.replace("{camera}", encodeURIComponent(player.camera)).replace("{frame}", String(this.session.info.frame));
    return new URL(path, document.baseURI).href;
  }
}
