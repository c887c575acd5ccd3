/**
 * Attributes as properties, as HTML's own elements have them.
 *
 * Attributes: src, controls, autoplay, loop, poster, preload, crossorigin, camera (a name), follow (the stream is still being written),
 * exact (drawn by the decoder's own kernel; "off": by WebGL2 wherever there is any; without it, by what is faster), recorded (cameras of the rig show
 * what they recorded: with lens and colours), background (the colour behind a subject; without it, the page shows there),
 * quality (a share of the pixels, and fewer Gaussians, for weak devices), range (frames A:B that are played again and again, B not among them), orbit (the view moves by itself until somebody takes it), limits ("rig": views stay where cameras have seen the scene from),
 * fence (the address of a map from above, written by decogs-report: views stay where it says that the scene holds),
 * max-gaussians and max-bitrate (bits a second: of a stream in layers, only the base is shown where all are above),
 * muted (without sound, to begin with), gestures ("cooperative": one finger and the wheel scroll the page, two fingers and Ctrl move the camera).
 */
import type { PlayerApi, Span } from "../player_api";

const PRELOADS = ["none", "metadata", "auto"] as const;

/** A server evaluates the module, too, and has no elements. */
const Base = "HTMLElement" in globalThis ? HTMLElement : (Object as unknown as typeof HTMLElement);

export abstract class AttributeElement extends Base {
  get src(): string {
    return this.getAttribute("src") ?? "";
  }
  set src(value: string) {
    this.setAttribute("src", value);
  }
  get poster(): string {
    return this.getAttribute("poster") ?? "";
  }
  set poster(value: string) {
    this.setAttribute("poster", value);
  }
  get preload(): PlayerApi["preload"] {
    const value = this.getAttribute("preload")?.toLowerCase();
    return PRELOADS.find((each) => each === value) ?? "auto";
  }
  set preload(value: PlayerApi["preload"]) {
    this.setAttribute("preload", value);
  }
  /** Whether a stream's server gets its cookies where it is another one than the page's. */
  get crossOrigin(): "anonymous" | "use-credentials" | null {
    const value = this.getAttribute("crossorigin");
    if (value === null) return null;
    return value.toLowerCase() === "use-credentials" ? "use-credentials" : "anonymous";
  }
  set crossOrigin(value: string | null) {
    if (value === null) this.removeAttribute("crossorigin");
    else this.setAttribute("crossorigin", value);
  }
  get controls(): boolean {
    return this.hasAttribute("controls");
  }
  set controls(value: boolean) {
    this.toggleAttribute("controls", value);
  }
  get autoplay(): boolean {
    return this.hasAttribute("autoplay");
  }
  set autoplay(value: boolean) {
    this.toggleAttribute("autoplay", value);
  }
  get loop(): boolean {
    return this.hasAttribute("loop");
  }
  set loop(value: boolean) {
    this.toggleAttribute("loop", value);
  }
  get recorded(): boolean {
    return this.hasAttribute("recorded");
  }
  set recorded(value: boolean) {
    this.toggleAttribute("recorded", value);
  }
  /** Frames that are played again and again. */
  get range(): Span | null {
    return spanOf(this.getAttribute("range"));
  }
  set range(value: Span | null) {
    if (value === null) this.removeAttribute("range");
    else this.setAttribute("range", `${value[0]}:${value[1]}`);
  }
  /** Gaussians that a stream's layers may have together; where they have more, the base is shown. */
  get maxGaussians(): number | null {
    return budgetOf(this.getAttribute("max-gaussians"));
  }
  set maxGaussians(value: number | null) {
    if (value === null) this.removeAttribute("max-gaussians");
    else this.setAttribute("max-gaussians", String(value));
  }
  /** Bits a second that a stream's layers may take together. */
  get maxBitrate(): number | null {
    return budgetOf(this.getAttribute("max-bitrate"));
  }
  set maxBitrate(value: number | null) {
    if (value === null) this.removeAttribute("max-bitrate");
    else this.setAttribute("max-bitrate", String(value));
  }
  get quality(): number {
    const share = Number(this.getAttribute("quality") ?? 1);
    return share > 0 && share <= 1 ? share : 1;
  }
  set quality(value: number) {
    if (!(value > 0 && value <= 1)) throw new RangeError("quality must be above 0 and at most 1");
    this.setAttribute("quality", String(value));
  }
}

/**
 * Sets properties once more that were set before the element was defined. They lie on the object itself until then, where
 * they would hide those that are meant.
 */
export function takeOverProperties(element: HTMLElement): void {
  // The address last: others say how it is opened.
  const values = Object.entries(element).sort(([one], [other]) => Number(one === "src") - Number(other === "src"));
  for (const [name, value] of values as [keyof HTMLElement, never][]) {
    if (!(name in Object.getPrototypeOf(element))) continue; // the page's own
    Reflect.deleteProperty(element, name);
    try {
      Reflect.set(element, name, value);
    } catch (error) {
      reportError(error); // the others count
    }
  }
}

function budgetOf(text: string | null): number | null {
  const value = Number(text ?? "");
  return text !== null && text.trim() !== "" && value >= 0 ? value : null;
}

/** Frames A:B, as commands have them; null for what is none. */
function spanOf(text: string | null): Span | null {
  const match = /^\s*(\d{1,9})\s*:\s*(\d{1,9})\s*$/.exec(text ?? "");
  if (match === null) return null;
  const [from, to] = [Number(match[1]), Number(match[2])];
  return from < to ? [from, to] : null;
}
