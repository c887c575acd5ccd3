/** How the scene is drawn, as attributes ask for it: exactly, as it was recorded, over what, and how finely; and what is painted over it. */
import { startRecorded } from "../draw/recorded";
import { OVERLAYS, type Overlay } from "../player_api";
import type { AttributeElement } from "./attributes";
import type { ExactChoice, Pictures } from "./pictures";
import type { Session } from "./session";

export class Appearance {
  #overlay: Overlay = "none";

  constructor(
    private readonly element: AttributeElement,
    private readonly session: Pick<Session, "send" | "notice">,
    private readonly poster: HTMLElement,
    private readonly pictures: () => Pictures | null,
    private readonly changed: () => void,
  ) {}

  get overlay(): Overlay {
    return this.#overlay;
  }
  set overlay(overlay: Overlay) {
    if (!OVERLAYS.includes(overlay)) throw new RangeError(`overlay must be one of ${OVERLAYS.join(", ")}`);
    this.#overlay = overlay;
    const pictures = this.pictures();
    if (pictures === null) return;
    pictures.overlay = overlay;
    this.changed();
  }

  get exactChoice(): ExactChoice {
    const value = this.element.getAttribute("exact");
    return value === null ? null : value !== "off";
  }

  chooseExact(): void {
    if (this.pictures()?.chooseExact(this.exactChoice) === true) this.changed();
  }

  layBehind(): void {
    this.pictures()?.layBehind(this.element.getAttribute("background"), this.poster);
  }

  chooseQuality(): void {
    const pictures = this.pictures();
    if (pictures === null) return;
    const { quality } = this.element;
    pictures.stage.quality = quality;
    this.session.send({ type: "detail", share: (1 + quality) / 2 }); // Gaussians are missed sooner than pixels
    this.changed();
  }

  async chooseRecorded(): Promise<void> {
    try {
      if (this.element.recorded) await startRecorded();
    } catch (error) {
      this.session.notice(`recorded pictures cannot be shown: ${error instanceof Error ? error.message : String(error)}`);
    }
    this.changed();
  }

  /** A stream has come. */
  open(): void {
    this.layBehind();
    if (this.element.quality < 1) this.chooseQuality();
  }
}
