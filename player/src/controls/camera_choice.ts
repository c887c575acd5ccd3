/** The cameras of the rig, to be chosen from: in the bar, or, where that is narrow, in the menu. */
import type { PlayerApi } from "../player_api";
import type { StreamHeader } from "../scene";

const FREE = "";
/** Pixels of the page: up to so many the bar is one row (style.css). */
const NARROW = 520;

export class CameraChoice {
  #header: StreamHeader | null = null;
  readonly #select: HTMLSelectElement;

  /** `cameras` with its list is put before `beside` in the bar's row, or at the head of the `menu`. */
  constructor(
    private readonly player: PlayerApi,
    private readonly cameras: HTMLElement,
    private readonly beside: HTMLElement,
    private readonly menu: HTMLElement,
  ) {
    this.#select = cameras.querySelector("select")!;
    this.#select.addEventListener("change", () => {
      const { value } = this.#select;
      if (value !== FREE) player.lookThrough(Number(value));
    });
  }

  refresh(): void {
    this.#arrange();
    const { header, camera } = this.player;
    if (header !== this.#header) {
      this.#header = header;
      this.#list();
    }
    const index = header?.cameras.findIndex(({ name }) => name === camera) ?? -1;
    this.#select.value = index >= 0 ? String(index) : FREE;
  }

  #arrange(): void {
    const narrow = this.player.clientWidth <= NARROW;
    if (narrow === this.menu.contains(this.cameras)) return;
    if (narrow) this.menu.prepend(this.cameras);
    else this.beside.before(this.cameras);
  }

  #list(): void {
    const free = new Option("free view", FREE, true, true);
    free.hidden = true;
    const { cameras = [], heldOut = [] } = this.#header ?? {};
    this.#select.replaceChildren(free, ...cameras.map(({ name }, index) => new Option(name + (heldOut.includes(name) ? " (held out)" : ""), String(index))));
  }
}
