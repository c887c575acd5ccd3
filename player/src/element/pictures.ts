/** The canvases of a player, what draws on them, and the poster over them. */
import { attachPointer } from "../camera/pointer";
import { ExactCanvas } from "../draw/exact_canvas";
import { createRenderer } from "../draw/index";
import type { Renderer } from "../draw/renderer";
import type { WebGlRenderer } from "../draw/webgl_renderer";
import type { PinholeCamera } from "../geometry/camera";
import type { Overlay } from "../player_api";
import { NO_ANSWER, type DepthRow, type ExactAnswer, type TextureLayout } from "../messages";
import type { StreamHeader } from "../scene";
import type { Session } from "./session";
import { Stage, type LookedThrough } from "./stage";

/** What pictures need of the element. */
export interface PicturesHost {
  readonly size: () => { readonly width: number; readonly height: number };
  readonly lookedThrough: () => LookedThrough | null;
  readonly cameraMoved: () => void;
  /** Another renderer draws. */
  readonly changed: () => void;
  /** Whether one finger and the wheel are the page's: it scrolls. */
  readonly cooperative: () => boolean;
  /** Says how the camera is moved, for a moment. */
  readonly hint: (text: string) => void;
}

/** Whether the kernel draws; null: where it is the faster one. */
export type ExactChoice = boolean | null;

/** A graphics card that takes so long for a picture, so many times in a row, is slower than the kernel. */
const SLOW_MS = 300;
const SLOW_PICTURES = 3;
/** After so long a lost graphics card counts as gone. */
const LOST_MS = 3000;

export class Pictures {
  readonly stage: Stage;
  readonly elements: readonly HTMLCanvasElement[];
  readonly #canvas = canvasOf("picture");
  /** It lies over the other one, which takes what the pointer does. */
  readonly #exactCanvas = canvasOf("picture exact");
  /** null without WebGL2: then the kernel draws. */
  #fast: WebGlRenderer | null;
  #lostTimer = 0;
  #choice: ExactChoice;
  /** Slow pictures of the graphics card in a row, and of the kernel those that took longer still; what the last one of the first took. */
  #slow = 0;
  #slower = 0;
  #fastMs = 0;
  #judgedMs = 0;
  /** Whether the kernel has failed since somebody chose last. */
  #kernelFailed = false;
  #overlay: Overlay = "none";
  readonly #detachPointer: () => void;
  #exactly: ExactCanvas | null = null;
  #begun: { readonly layout: TextureLayout; readonly header: StreamHeader } | null = null;

  /** `session`: has the worker sort, send and draw. */
  constructor(
    private readonly session: Pick<Session, "send" | "lost">,
    private readonly host: PicturesHost,
    choice: ExactChoice,
  ) {
    this.#choice = choice;
    this.elements = [this.#canvas, this.#exactCanvas];
    const restored = (): void => {
      clearTimeout(this.#lostTimer);
      this.#resend();
    };
    this.#fast = fastRenderer(this.#canvas, restored, () => {
      if (!this.exact) this.stage.forget();
      this.#lostTimer = window.setTimeout(() => {
        this.#giveUpFast();
      }, LOST_MS);
    });
    const sort = (depth: DepthRow, serial: number): void => {
      session.send({ type: "view", depth, serial });
    };
    this.stage = new Stage(this.#rightRenderer(), host.size, sort, host.lookedThrough);
    this.stage.navigation.calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.#detachPointer = attachPointer(this.#canvas, this.stage.navigation, host);
  }

  get canChooseExact(): boolean {
    return this.#fast !== null;
  }

  /** What draws for headsets; null without WebGL2. From now on it draws, whatever was chosen. */
  forHeadset(): WebGlRenderer | null {
    this.chooseExact(false);
    return this.#fast;
  }

  get exact(): boolean {
    return this.stage.renderer === this.#exactly;
  }

  /** What draws from now on begins with the whole frame. Whether another one does. */
  chooseExact(choice: ExactChoice): boolean {
    this.#choice = choice;
    this.#kernelFailed = false;
    return this.#change();
  }

  set overlay(overlay: Overlay) {
    this.#overlay = this.stage.overlay = overlay;
    this.#change(); // the kernel draws none
    this.stage.touch();
  }

  /**
   * Where nobody has chosen: slow pictures of the graphics card give way to the kernel's, and those of the kernel that are slow,
   * too, and slower, to the graphics card's again, for good. Asked once a picture.
   */
  judge(): void {
    const { drawMs } = this.stage.renderer.times;
    if (this.#choice !== null || this.#fast === null || drawMs === this.#judgedMs) return;
    this.#judgedMs = drawMs;
    if (this.exact) {
      this.#slower = this.#fastMs > 0 && drawMs > Math.max(SLOW_MS, this.#fastMs) ? this.#slower + 1 : 0;
    } else {
      this.#slow = drawMs > SLOW_MS ? this.#slow + 1 : 0;
      this.#fastMs = drawMs;
    }
    if (this.#change()) this.host.changed();
  }

  get #automatic(): boolean {
    return this.#slower < SLOW_PICTURES && this.#overlay === "none" && (this.#fast?.inSoftware === true || this.#slow >= SLOW_PICTURES);
  }

  #change(): boolean {
    const renderer = this.#rightRenderer();
    if (renderer === this.stage.renderer) return false;
    this.stage.renderer = renderer;
    if (this.#begun !== null) renderer.begin(this.#begun.layout, this.#begun.header);
    this.#resend();
    this.stage.touch();
    return true;
  }

  begin(layout: TextureLayout, header: StreamHeader): void {
    this.#begun = { layout, header };
    this.stage.transform = header.presentation.transform;
    this.stage.renderer.begin(layout, header);
  }

  /** A subject lies over the page, or over a colour; null: none was named. */
  layBehind(background: string | null, poster: HTMLElement): void {
    const clear = this.#begun?.header.subject ?? background !== null;
    for (const picture of [...this.elements, poster]) {
      picture.classList.toggle("clear", clear);
      picture.style.backgroundColor = clear ? (background ?? "") : "";
    }
  }

  /** Whether the first picture is still to come from the kernel. */
  get awaitsKernel(): boolean {
    return this.exact && this.#exactly!.empty;
  }

  /** One picture that is too large leaves a kernel that somebody chose, and that has drawn. */
  exactlyDrawn({ picture, problem, kernel }: ExactAnswer): void {
    if (picture !== null) {
      this.#exactly?.show(picture);
      return;
    }
    if (problem !== null && (!kernel || this.awaitsKernel || this.#choice === null)) this.#kernelFailed = true;
    if (this.#change()) this.host.changed();
    this.#exactly?.failed(problem);
  }

  dispose(): void {
    clearTimeout(this.#lostTimer);
    this.#detachPointer();
    this.#fast?.dispose();
    this.#exactly?.dispose();
    for (const canvas of this.elements) canvas.remove();
  }

  /** A graphics card that does not come back: the kernel draws from now on. */
  #giveUpFast(): void {
    this.#fast?.dispose();
    this.#fast = null;
    if (this.#change()) this.host.changed();
  }

  #resend(): void {
    this.session.send({ type: "resend" });
  }

  readonly #drawExactly = (camera: PinholeCamera): void => {
    if (this.session.lost.aborted) this.exactlyDrawn(NO_ANSWER);
    else this.session.send({ type: "exact", camera });
  };

  #rightRenderer(): Renderer {
    const fast = !this.#kernelFailed && (this.#choice ?? this.#automatic) ? null : this.#fast;
    this.#exactCanvas.hidden = fast !== null;
    this.#canvas.style.opacity = fast === null ? "0" : ""; // the other one may be transparent
    if (fast !== null) return fast;
    return (this.#exactly ??= new ExactCanvas(this.#exactCanvas, this.#drawExactly));
  }
}

function canvasOf(className: string): HTMLCanvasElement {
  const canvas = document.createElement("canvas");
  canvas.className = className;
  canvas.ariaHidden = "true"; // the element has a name
  return canvas;
}

function fastRenderer(canvas: HTMLCanvasElement, onRestored: () => void, onLost: () => void): WebGlRenderer | null {
  try {
    return createRenderer(canvas, onRestored, onLost);
  } catch {
    return null;
  }
}
