/** What people take along: the picture and the frame as files; the camera, a link to the view, and a page's code as texts. */
import type { PlayerApi } from "../player_api";
import { cameraToLink, poseFile } from "./camera_text";
import type { Notices } from "./notices";

export class Sharing {
  constructor(
    private readonly player: PlayerApi,
    private readonly notices: Notices,
  ) {}

  async savePicture(): Promise<void> {
    await this.#save(this.player.capture(), `${this.player.camera || "view"}_${this.#frameText()}.png`);
  }

  async savePly(): Promise<void> {
    await this.#save(this.player.ply(), `frame_${this.#frameText()}.ply`);
  }

  async copyPose(): Promise<void> {
    const camera = this.player.currentCamera();
    if (camera !== null) await this.#copy(poseFile(camera), "Copied: save it as pose.json for decogs-decode --camera");
  }

  async copyLink(): Promise<void> {
    await this.#copy(this.#address(), "Copied: a link to this view and frame");
  }

  async copyEmbed(): Promise<void> {
    const quoted = this.#address().replace(/&/g, "&amp;").replace(/"/g, "&quot;");
    const frame = `<iframe src="${quoted}" title="Free-viewpoint video" style="border: 0; width: 100%; aspect-ratio: 16 / 9" allow="fullscreen; clipboard-write; xr-spatial-tracking"></iframe>`;
    await this.#copy(frame, "Copied: code that shows this page in yours");
  }

  /** The address of this page at this view and frame. */
  #address(): string {
    const { view, currentFrame } = this.player;
    const address = new URL(location.href);
    if (view !== null) address.hash = `camera=${cameraToLink(view.pose, view.lens)}&frame=${currentFrame}`;
    return address.href;
  }

  /** Gives what is made, once it is, to whoever looks at the page, as a file. */
  async #save(made: Promise<Blob>, name: string): Promise<void> {
    try {
      const link = document.createElement("a");
      link.href = URL.createObjectURL(await made);
      link.download = name;
      link.click();
      setTimeout(() => {
        URL.revokeObjectURL(link.href);
      }, 10_000);
    } catch (error) {
      this.notices.say(error instanceof Error ? error.message : String(error));
    }
  }

  async #copy(text: string, done: string): Promise<void> {
    try {
      await navigator.clipboard.writeText(text);
      this.notices.say(done);
    } catch {
      // A page without leave for the clipboard (plain http, a frame): the text can be copied by hand.
      window.prompt("Copy this:", text);
    }
  }

  #frameText(): string {
    return String(this.player.info?.frame ?? 0).padStart(4, "0");
  }
}
