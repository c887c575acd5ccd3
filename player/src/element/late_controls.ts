/** The controls: a script of their own, which comes behind the first picture. Without them the picture still plays. */
import type { Panels } from "../controls/panels";
import type { PlayerApi } from "../player_api";

type Controls = typeof import("../controls/index");

/** When controls come although there is no picture yet. */
const AFTER_MS = 400;

export class LateControls {
  panels: Panels | null = null;
  #controls: Controls | null = null;
  #coming = false;
  #timer = 0;
  #busy = false;
  #share: number | null = null;
  #warning: string | null = null;

  constructor(
    private readonly player: PlayerApi,
    private readonly root: ShadowRoot,
  ) {
    for (const name of ["keydown", "keyup"] as const) {
      player.addEventListener(name, (event) => {
        this.#key(event);
      });
    }
    player.addEventListener("blur", () => {
      this.#controls?.forgetKeys(player); // another window sees them released
    });
  }

  /** Before the first picture is there, nothing but what leads to it; where it takes long, people are told. */
  setLoading(on: boolean): void {
    this.setBusy(on, null);
    clearTimeout(this.#timer);
    if (!on) this.start();
    else {
      this.#timer = window.setTimeout(() => {
        this.start();
      }, AFTER_MS);
    }
  }

  /** Shows that something is waited for, and how much of it is there, where that is known. */
  setBusy(on: boolean, share: number | null): void {
    this.#busy = on;
    this.#share = share;
    this.panels?.busy(on, share);
  }

  /** Says what is wrong for as long as it is; null when nothing is. */
  warn(text: string | null): void {
    this.#warning = text;
    this.panels?.warn(text);
  }

  /** Has the controls come, once. */
  start(): void {
    clearTimeout(this.#timer);
    if (this.#coming) return;
    this.#coming = true;
    import("../controls/index").then(
      (controls) => {
        this.#put(controls);
      },
      (error: unknown) => {
        this.#coming = false;
        console.error("the player's controls cannot be loaded", error);
      },
    );
  }

  rest(): void {
    clearTimeout(this.#timer);
  }

  /** What a key asks for; those that come before the controls have them come. */
  #key(event: KeyboardEvent): void {
    if (this.panels === null) this.start();
    else if (this.#controls?.looksInto(this.player, this.panels, event) === true) event.preventDefault();
  }

  #put(controls: Controls): void {
    this.#controls = controls;
    this.panels = new controls.Panels(this.player, this.root);
    this.panels.busy(this.#busy, this.#share);
    this.panels.warn(this.#warning);
    this.panels.invite();
    this.panels.tellCamera();
    this.panels.refresh();
  }
}
