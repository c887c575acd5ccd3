/** Pictures of keyframes for the timeline: of those whose bytes are there, one at a time, as the view is when they are asked for. */
import type { Pose } from "../geometry/poses";
import type { PlayerApi } from "../player_api";
import type { StreamHeader } from "../scene";

const WIDTH = 160;

export class Thumbnails {
  readonly canvas = document.createElement("canvas");
  /** Whose pictures these are: a pose, and a stream's header. */
  private seenFrom: Pose | undefined;
  private of: StreamHeader | null = null;
  private pictures = new Map<number, ImageData | null>();
  private wanted = -1;
  private shown = -1;
  private busy = false;

  constructor(private readonly player: PlayerApi) {
    this.canvas.hidden = true;
  }

  /** Shows the picture of the keyframe at or before a frame, as soon as it is there. */
  show(frame: number): void {
    const { frames, bufferedFrames, view, header } = this.player;
    if (view?.pose !== this.seenFrom || header !== this.of) {
      [this.seenFrom, this.of] = [view?.pose, header];
      this.pictures = new Map<number, ImageData | null>();
      this.shown = -1;
    }
    const key = frames.kind(frame) === "key" ? frame : frames.keyframe(frame, -1);
    this.wanted = bufferedFrames.some(([from, to]) => from <= key && key < to) ? key : -1;
    const picture = this.pictures.get(this.wanted) ?? null;
    this.canvas.hidden = picture === null;
    if (picture === null) void this.make();
    else if (this.shown !== this.wanted) {
      Object.assign(this.canvas, { width: picture.width, height: picture.height });
      this.canvas.getContext("2d")!.putImageData(picture, 0, 0);
      this.shown = this.wanted;
    }
  }

  private async make(): Promise<void> {
    const { pictures, wanted } = this;
    if (this.busy || wanted < 0 || pictures.has(wanted)) return;
    this.busy = true;
    // One that does not come is not worth a word; the frame itself will say what is wrong.
    pictures.set(wanted, await this.player.thumbnail(wanted, WIDTH).catch(() => null));
    this.busy = false;
    if (this.wanted >= 0) this.show(this.wanted);
  }
}
