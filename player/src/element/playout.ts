/**
 * A stream as it plays in an element: the worker decodes and sorts, the stage draws, the panels are for people; this holds them
 * together, and says when a stream is opened, waited with, left and taken up again.
 */
import { adopt } from "../adopted_style";
import type { Budget } from "../messages";
import type { PlayerApi, View } from "../player_api";
import type { StreamHeader } from "../scene";
import { Accessibility } from "./accessibility";
import { absolute } from "./address";
import { Appearance } from "./appearance";
import type { AttributeElement } from "./attributes";
import { Captures } from "./captures";
import type { PlayerEvent } from "./events";
import { FenceFile } from "./fence_file";
import { FrameCallbacks } from "./frame_callbacks";
import { Headset } from "./headset";
import { LateControls } from "./late_controls";
import { Pictures } from "./pictures";
import { PixelRatio } from "./pixel_ratio";
import { Poster } from "./poster";
import { Session } from "./session";
import { Sight } from "./sight";
import style from "./style.css";
import { Ticker } from "./ticker";
import { UnseenPause } from "./unseen_pause";
import { Viewpoint } from "./viewpoint";

/** What an element that left the page takes up again. */
interface Left {
  readonly source: string;
  readonly frame: number;
  readonly camera: string;
  readonly view: View | null;
}

export class Playout {
  readonly session: Session = new Session({
    tell: (name) => {
      this.tell(name);
    },
    wake: () => {
      this.wake();
    },
    loading: (on) => {
      this.controls.setLoading(on);
    },
    busy: (on, share) => {
      this.controls.setBusy(on, share);
    },
    reopen: () => {
      this.open();
      if (this.#deferred) this.#begin(); // who plays has it come
    },
    warn: (text) => {
      this.controls.warn(text);
    },
    opened: (header) => {
      this.#opened(header);
    },
    autoplay: () => this.element.autoplay && !this.#unseenPause.holdBack(),
  });
  readonly headset: Headset = new Headset(
    this.session,
    () => {
      this.pictures?.chooseExact(this.appearance.exactChoice);
      this.tell("xrend");
      this.wake();
    },
    () => {
      if (this.element.paused) this.element.play().catch(() => undefined);
      else this.element.pause();
    },
  );
  readonly viewpoint = new Viewpoint({
    navigation: () => this.pictures?.stage.navigation ?? null,
    moved: () => {
      this.pictures?.stage.touch();
      this.tell("camerachange");
      this.wake();
    },
    put: () => {
      this.controls.panels?.tellCamera();
    },
    asked: () => {
      this.#poster.giveWay();
    },
  });
  readonly frameCallbacks = new FrameCallbacks();
  readonly appearance: Appearance;
  readonly captures: Captures;
  readonly controls: LateControls;
  pictures: Pictures | null = null;
  /** The address of the stream that is open or was open last. */
  source = "";
  /** Where it stood when the element left the page. */
  #left: Left | null = null;
  /** Whether the stream is opened when somebody plays it. */
  #deferred = false;
  readonly #poster = new Poster();
  readonly #fence = new FenceFile(
    (fence) => {
      this.viewpoint.fence = fence;
    },
    (why) => {
      console.warn(why);
    },
  );
  readonly #accessibility: Accessibility;
  readonly #unseenPause: UnseenPause;
  readonly #ticker = new Ticker((now, seconds) => {
    this.#tick(now, seconds);
  });
  readonly #resized = new ResizeObserver(() => {
    this.touch();
  });
  readonly #ratio = new PixelRatio(() => {
    this.touch();
  });
  readonly #sight = new Sight(() => {
    this.sightChanged();
  });

  constructor(
    private readonly element: AttributeElement & PlayerApi,
    root: ShadowRoot,
  ) {
    const pictures = (): Pictures | null => this.pictures;
    this.appearance = new Appearance(element, this.session, this.#poster.image, pictures, () => {
      this.touch();
    });
    this.captures = new Captures(element, this.session, pictures, () => this.#ratio.value);
    this.controls = new LateControls(element, root);
    this.#accessibility = new Accessibility(element);
    this.#unseenPause = new UnseenPause(element, () => this.#sight.isUnseen(this.session.sound.audible || this.headset.entered));
    adopt(root, style);
    root.append(this.#poster.image);
    element.addEventListener("blur", () => {
      if (this.viewpoint.isFlying) this.viewpoint.fly([0, 0, 0]);
    });
  }

  /** The element is in a page. */
  enter(): void {
    const { element } = this;
    this.#accessibility.begin();
    this.#resized.observe(element);
    this.#ticker.moveTo(element.ownerDocument);
    this.#ratio.begin(this.#ticker.window);
    this.#sight.begin(element);
    if (this.pictures === null || this.source !== this.#address) this.open();
  }

  /** An element that is moved in the page is put in again at once: then everything goes on. */
  leave(): void {
    this.#resized.disconnect();
    this.#ratio.end();
    this.#sight.end();
    queueMicrotask(() => {
      if (!this.element.isConnected) this.#release();
    });
  }

  attributeChanged(name: string, value: string | null): void {
    const { element, appearance, viewpoint } = this;
    const { playback } = this.session;
    if ((name === "src" || name === "crossorigin") && element.isConnected) this.open();
    if (this.#deferred && !this.#defers) this.#begin();
    if (name === "loop") playback.loop = value !== null;
    if (name === "poster") this.#poster.address = element.poster;
    if (name === "exact") appearance.chooseExact();
    if (name === "recorded") void appearance.chooseRecorded();
    if (name === "background") appearance.layBehind();
    if (name === "orbit") {
      viewpoint.sway(value !== null);
      this.wake();
    }
    if (name === "muted") element.muted = value !== null;
    if (name === "fence") this.#fence.address = value ?? "";
    if (name === "limits" || name === "fence") this.#limit();
    if (name === "quality") appearance.chooseQuality();
    if (name === "max-gaussians" || name === "max-bitrate") this.session.send({ type: "budget", budget: budgetOf(element) });
    if (name === "range") playback.range = element.range;
    if (name === "camera" && value !== null) element.camera = value;
    this.controls.panels?.refresh();
  }

  play(): Promise<void> {
    this.#unseenPause.forget();
    if (this.#deferred) this.#begin();
    return this.session.play();
  }

  pause(): void {
    this.#unseenPause.forget();
    this.session.pause();
  }

  /** Opens the stream anew. */
  open(): void {
    this.#close();
    this.source = this.#address;
    if (this.source === "") {
      this.controls.start();
      return;
    }
    if (this.#left?.source === this.source) this.session.start ??= { frame: this.#left.frame };
    else this.#left = null;
    if (this.#defers) {
      this.#deferred = true;
      this.controls.start();
    } else this.#begin();
  }

  /** Something is to be drawn or to be waited for: ticks until it is done. */
  wake(): void {
    this.#ticker.wake();
  }

  /** The picture that is waited for; 0: none. */
  get ticking(): number {
    return this.#ticker.request;
  }

  /** Something to be seen has changed. */
  touch(): void {
    this.pictures?.stage.touch();
    this.controls.panels?.refresh();
    this.wake();
  }

  tell(name: PlayerEvent): void {
    if (name === "play" || name === "seeking") this.#poster.giveWay();
    if (name === "seeked") this.frameCallbacks.sought();
    this.element.dispatchEvent(new Event(name));
    this.controls.panels?.refresh();
  }

  /** Whether somebody sees or hears it may have changed. */
  sightChanged(): void {
    this.#unseenPause.update();
    this.wake();
  }

  #tick(now: number, seconds: number): void {
    const { playback } = this.session;
    const stage = this.pictures?.stage;
    if (stage === undefined || this.headset.entered) return;
    this.session.advance(seconds);
    this.session.sound.listen(stage.navigation.pose);
    // play() waits for the kernel's first picture, seen or not.
    if (!this.#sight.offScreen || (playback.playing && this.pictures?.awaitsKernel === true)) {
      if (stage.step(now, seconds, playback.playing)) this.#drawn(now);
      this.pictures?.judge();
    }
    this.controls.panels?.tick(now);
    const changing = stage.pending || stage.renderer.busy || this.viewpoint.isMoving;
    if (playback.playing || (changing && !this.#sight.offScreen)) this.wake();
  }

  #drawn(now: number): void {
    this.#poster.drawn();
    const { info, playback } = this.session;
    if (info === null) return;
    const { width = 0, height = 0 } = this.viewpoint.view?.lens ?? {};
    this.frameCallbacks.drawn(info.frame, now, { width, height, fps: playback.fps, costMs: info.decodeMs + info.packMs });
  }

  /** What is no address stays as it was written. */
  get #address(): string {
    const { src } = this.element;
    return src === "" ? "" : (absolute(src) ?? src);
  }

  /** Whether nothing is to be read before somebody plays. */
  get #defers(): boolean {
    return this.element.preload === "none" && !this.element.autoplay && this.#left === null;
  }

  /** Has the stream come. */
  #begin(): void {
    const { element, source } = this;
    this.#deferred = false;
    try {
      if (absolute(source) === null) throw new Error(`${source} is no address`);
      this.pictures ??= this.#newPictures();
    } catch (error) {
      this.session.fail(error instanceof Error ? error.message : String(error));
      return;
    }
    const opening = { source, follow: element.hasAttribute("follow"), sparing: element.preload === "metadata" && !element.autoplay };
    this.session.open(element.crossOrigin === "use-credentials" ? { ...opening, credentials: "include" } : opening, this.pictures);
    const budget = budgetOf(element);
    if (Object.keys(budget).length > 0) this.session.send({ type: "budget", budget });
  }

  #opened(header: StreamHeader): void {
    const { element, viewpoint } = this;
    const left = this.#left;
    this.#left = null;
    this.#accessibility.setTitle(header.presentation.title);
    viewpoint.open(header, this.pictures!.stage.navigation, left?.camera || element.getAttribute("camera"), left?.camera === "" ? left.view : null);
    this.#limit();
    viewpoint.sway(element.hasAttribute("orbit"));
    this.appearance.open();
  }

  #limit(): void {
    const { element } = this;
    this.viewpoint.limit(element.getAttribute("limits") === "rig" || element.hasAttribute("fence"));
  }

  #close(): void {
    this.#deferred = false;
    this.#unseenPause.forget();
    this.session.close();
    this.#poster.stand();
    this.frameCallbacks.begin();
    this.viewpoint.close();
    this.controls.panels?.refresh();
  }

  /** Gives everything back that an element outside of the page does not need. */
  #release(): void {
    void this.headset.leave();
    if (this.session.header !== null) {
      const { currentFrame: frame, camera, view } = this.element;
      this.#left = { source: this.source, frame, camera, view };
    }
    this.#close();
    this.controls.rest();
    this.pictures?.dispose();
    this.pictures = null;
  }

  #newPictures(): Pictures {
    const { element, appearance } = this;
    const host = {
      size: () => this.captures.size(),
      lookedThrough: () => {
        const camera = element.recorded ? this.viewpoint.camera : null;
        return camera === null ? null : { camera, correction: this.session.info?.corrections.get(camera.name) ?? null };
      },
      cameraMoved: () => {
        this.viewpoint.moved();
      },
      changed: () => {
        this.touch();
      },
      cooperative: () => element.getAttribute("gestures") === "cooperative" && document.fullscreenElement !== element && !element.classList.contains("fills"),
      hint: (text: string) => {
        this.controls.panels?.hint(text);
      },
    };
    const pictures = new Pictures(this.session, host, appearance.exactChoice);
    pictures.overlay = appearance.overlay;
    this.#poster.image.before(...pictures.elements);
    return pictures;
  }
}

/** What a stream's layers may take together, where anybody says: the page, or a person who saves data. */
function budgetOf({ maxGaussians, maxBitrate }: AttributeElement): Budget {
  const { navigator } = globalThis as { readonly navigator?: { readonly connection?: { readonly saveData?: boolean } } };
  const saves = navigator?.connection?.saveData === true;
  const bitsPerSecond = saves ? 0 : maxBitrate;
  return { ...(maxGaussians !== null && { gaussians: maxGaussians }), ...(bitsPerSecond !== null && { bitsPerSecond }) };
}
