/** Headsets: whether there is one, and the scene in it; the script comes when somebody enters. */
import { intoScene } from "../geometry/similarity";
import type { Show, XrMode } from "../xr/show";
import type { Pictures } from "./pictures";
import type { Session } from "./session";

/** 72 pictures a second on a Quest 3 end at about so many Gaussians (README of ninjamode/Unity-VR-Gaussian-Splatting). */
export const HEADSET_GAUSSIANS = 400_000;

export class Headset {
  #show: Show | null = null;

  constructor(
    private readonly session: Session,
    /** Somebody came back. */
    private readonly ended: () => void,
    private readonly playOrPause: () => void,
  ) {}

  get entered(): boolean {
    return this.#show !== null;
  }

  /** Rejects, in one sentence, where nothing can be entered. */
  async enter(mode: XrMode, pictures: Pictures): Promise<void> {
    const renderer = pictures.forHeadset();
    if (renderer === null) throw new Error("without WebGL2 there are no pictures for headsets");
    const { stage } = pictures;
    const { navigation } = stage;
    const { Show } = await import("../xr/show");
    navigation.sway(false);
    this.#show = await Show.begin(mode, {
      gl: renderer.context,
      pose: navigation.pose,
      up: navigation.up,
      size: navigation.size,
      draw: (camera, target) => {
        renderer.drawInto(intoScene(camera, stage.transform), stage.overlay, target);
      },
      sort: (depth) => {
        stage.sortFor(depth);
      },
      advance: (seconds) => {
        this.session.advance(seconds);
      },
      playOrPause: this.playOrPause,
      ended: () => {
        this.#show = null;
        pictures.chooseExact(null);
        stage.touch();
        this.ended();
      },
    });
    const count = this.session.info?.count ?? 0;
    if (count > HEADSET_GAUSSIANS) {
      this.session.notice(`${count} Gaussians: a headset without a computer shows ${HEADSET_GAUSSIANS} smoothly`);
    }
  }

  async leave(): Promise<void> {
    await this.#show?.end();
  }
}
