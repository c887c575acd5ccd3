/** The controls over the picture: the bar, its menu, help, figures and notices. They act through the player alone. */
import type { Overlay, PlayerApi } from "../player_api";
import { ownMarkup } from "../trusted";
import { adopt } from "../adopted_style";
import { CameraChoice } from "./camera_choice";
import { cameraNote } from "./camera_note";
import type { CropTool } from "./crop";
import { Comparison } from "./comparison";
import { icon } from "./icons";
import { playOrPause } from "./keys";
import { Legend } from "./legend";
import { markup } from "./markup";
import { Notices } from "./notices";
import { Sharing } from "./sharing";
import style from "./style.css";
import { Statistics } from "./statistics";
import { Timeline } from "./timeline";
import { timeText } from "./time_text";
import { SoundControls } from "./sound_controls";

const IDLE_MS = 2600;
const SPINNER_AFTER_MS = 250;

export class Panels {
  private readonly timeline: Timeline;
  private readonly statistics: Statistics;
  private readonly comparison: Comparison;
  private readonly sound: SoundControls;
  private readonly cameras: CameraChoice;
  private readonly legend: Legend;
  private readonly notices: Notices;
  private readonly sharing: Sharing;
  private readonly closers: readonly HTMLElement[];
  private refreshing = false;
  private idleTimer = 0;
  private loadingTimer = 0;
  private shownBusy = false;
  private invited = false;
  /** The frame that a loop is to begin with, once its end is marked. */
  private marked: number | null = null;
  private crop: CropTool | null = null;
  /** What had the focus before a panel was opened. */
  private opener: HTMLElement;

  constructor(
    private readonly player: PlayerApi,
    private readonly root: ShadowRoot,
  ) {
    const holder = document.createElement("div");
    holder.className = "controls";
    holder.innerHTML = ownMarkup(markup());
    adopt(root, style);
    root.append(holder);
    this.opener = player;
    this.timeline = new Timeline(player, this.part(".timeline"));
    this.statistics = new Statistics(player, this.part(".figures"));
    this.comparison = new Comparison(player, this.part(".recording"), this.part(".divider"));
    this.sound = new SoundControls(player, this.part(".sound"));
    this.cameras = new CameraChoice(player, this.part(".cameras"), this.field("menu"), this.part(".menu"));
    this.legend = new Legend(player, this.part(".legend"));
    this.notices = new Notices(this.part(".notice"));
    this.sharing = new Sharing(player, this.notices);
    this.closers = [this.part(".menu"), this.part(".help")];
    this.listen();
  }

  /** Brings everything in step with the player, once before the next picture however often it is asked for. */
  refresh(): void {
    if (this.refreshing) return;
    this.refreshing = true;
    requestAnimationFrame(() => {
      this.refreshing = false;
      this.update();
    });
  }

  tick(now: number): void {
    this.statistics.tick(now);
    this.crop?.refresh();
    if (this.player.comparing) this.comparison.refresh();
  }

  /** `share`: how much of what is waited for is there, from 0 to 1; null: nobody knows. */
  busy(on: boolean, share: number | null): void {
    this.part(".percent").textContent = share === null ? "" : `${Math.floor(100 * share)} %`;
    if (on === this.shownBusy) return;
    this.shownBusy = on;
    clearTimeout(this.loadingTimer);
    const show = (): void => {
      this.part(".veil").hidden = !on;
    };
    if (on) this.loadingTimer = window.setTimeout(show, SPINNER_AFTER_MS);
    else show();
  }

  /** Says, for a moment, what the picture of the camera that is looked through leaves out. */
  tellCamera(): void {
    const { header, camera } = this.player;
    const note = header === null || this.player.recorded ? null : cameraNote(header, camera);
    if (note !== null) this.hint(note);
  }

  /** Says what is wrong for as long as it is; null when nothing is. */
  warn(text: string | null): void {
    this.notices.warn(text);
  }

  /** Tells people once that the picture is theirs to turn. */
  invite(): void {
    if (this.invited || !this.player.controls || this.player.info === null) return;
    this.invited = true;
    this.hint(this.player.getAttribute("gestures") === "cooperative" ? "Use two fingers, or drag, to look around" : "Drag to look around");
  }

  /** Says something for a moment, unless something is wrong. */
  hint(text: string): void {
    this.notices.hint(text);
  }

  toggleHelp(): void {
    this.toggle(".help");
  }

  toggleStatistics(): void {
    const panel = this.part(".figures");
    panel.hidden = !panel.hidden;
    this.statistics.refresh();
    this.refresh();
  }

  /** Closes menu and help, and gives the focus back to what opened them; whether anything was open. */
  closeAll(): boolean {
    const open = this.closers.filter((panel) => !panel.hidden);
    const focused = open.some((panel) => panel.contains(this.root.activeElement));
    for (const panel of open) panel.hidden = true;
    if (focused) this.opener.focus();
    this.refresh();
    return open.length > 0;
  }

  /** Phones that give the whole screen to <video> only let the player fill the window. */
  async toggleFullScreen(): Promise<void> {
    const { classList } = this.root.host;
    if (classList.contains("fills")) classList.remove("fills");
    else if (document.fullscreenElement !== null) await document.exitFullscreen();
    else {
      try {
        await this.player.requestFullscreen();
      } catch {
        classList.add("fills");
      }
    }
  }

  /** Out of what fills the window; whether it did. */
  leaveFullWindow(): boolean {
    const { classList } = this.root.host;
    const fills = classList.contains("fills");
    classList.remove("fills");
    return fills;
  }

  private async startCrop(): Promise<void> {
    if (this.crop !== null) this.crop.open();
    else {
      const { CropTool } = await import("./crop");
      this.crop = new CropTool(this.player, this.root);
    }
  }

  /** The first frame of a loop, the last one, and no loop any more, one after the other. */
  mark(): void {
    const { player } = this;
    const frame = player.currentFrame;
    if (player.range !== null) {
      player.range = null;
      this.marked = null;
      this.hint("No loop");
    } else if (this.marked === null) {
      this.marked = frame;
      this.hint(`Loop from frame ${frame}; X again where it ends`);
    } else {
      player.range = [Math.min(frame, this.marked), Math.max(frame, this.marked) + 1];
      this.marked = null;
      this.hint(`Loop of frames ${player.range[0]} to ${player.range[1] - 1}`);
    }
    this.timeline.mark(this.marked);
    this.refresh();
  }

  async savePicture(): Promise<void> {
    await this.sharing.savePicture();
  }

  private listen(): void {
    const { player } = this;
    for (const button of [".play", ".start"]) {
      this.part(button).addEventListener("click", () => {
        playOrPause(player);
      });
    }
    this.part(".shut").addEventListener("click", () => {
      this.toggleHelp();
    });
    const actions: Readonly<Record<string, () => void>> = {
      previous: () => {
        player.nextCamera(-1);
      },
      next: () => {
        player.nextCamera(1);
      },
      menu: () => {
        void this.offerXr();
        this.toggle(".menu");
      },
      full: () => {
        void this.toggleFullScreen();
      },
      picture: () => void this.savePicture(),
      ply: () => void this.sharing.savePly(),
      crop: () => void this.startCrop(),
      pose: () => void this.sharing.copyPose(),
      link: () => void this.sharing.copyLink(),
      embed: () => void this.sharing.copyEmbed(),
      vr: () => void this.enterXr("immersive-vr"),
      ar: () => void this.enterXr("immersive-ar"),
      help: () => {
        this.toggleHelp();
      },
    };
    for (const [name, act] of Object.entries(actions)) {
      this.field(name).addEventListener("click", () => {
        if (name !== "menu") this.closeAll();
        act();
      });
    }
    this.select("overlay").addEventListener("change", ({ target }) => {
      player.overlay = (target as HTMLSelectElement).value as Overlay;
    });
    this.select("rate").addEventListener("change", ({ target }) => {
      player.playbackRate = Number((target as HTMLSelectElement).value);
    });
    this.select("quality").addEventListener("change", ({ target }) => {
      player.quality = Number((target as HTMLSelectElement).value);
    });
    this.field("loop").addEventListener("change", ({ target }) => {
      player.loop = (target as HTMLInputElement).checked;
    });
    this.field("exact").addEventListener("change", ({ target }) => {
      player.exact = (target as HTMLInputElement).checked;
    });
    this.field("recorded").addEventListener("change", ({ target }) => {
      player.recorded = (target as HTMLInputElement).checked;
    });
    this.field("comparing").addEventListener("change", ({ target }) => {
      player.comparing = (target as HTMLInputElement).checked;
    });
    this.field("figures").addEventListener("change", () => {
      this.toggleStatistics();
    });
    player.addEventListener("loadeddata", () => {
      this.invite();
    });
    for (const name of ["pointermove", "pointerdown", "keydown", "focusin"] as const) {
      player.addEventListener(name, () => {
        this.awake();
      });
    }
    player.addEventListener("pointerdown", (event) => {
      const path = event.composedPath();
      const inside = [...this.closers, this.field("menu")].some((panel) => path.includes(panel));
      if (!inside) this.closeAll();
    });
  }

  private update(): void {
    const { player } = this;
    const { classList } = this.root.host;
    if (player.paused === classList.contains("playing")) this.awake(); // the bar goes by itself, whoever plays
    classList.toggle("playing", !player.paused);
    this.cameras.refresh();
    const [button, text] = player.paused ? (player.ended ? ["replay", "Play again"] : ["play", "Play"]) : ["pause", "Pause"];
    const play = this.part(".play");
    if (play.getAttribute("aria-label") !== text) {
      play.innerHTML = ownMarkup(icon(button as "play"));
      play.setAttribute("aria-label", text);
    }
    this.part(".start").hidden = player.controls || !player.paused || (player.info === null && player.preload !== "none");
    this.part(".now-at").textContent = player.header === null ? "" : timeText(player.currentTime);
    this.part(".of").textContent = player.header === null ? "" : ` / ${timeText(player.duration)}`;
    this.select("overlay").value = player.overlay;
    choose(this.select("rate"), player.playbackRate, `${player.playbackRate} ×`);
    choose(this.select("quality"), player.quality, `${Math.round(100 * player.quality)} %`);
    this.input("loop").checked = player.loop;
    this.input("exact").checked = player.exact;
    this.input("exact").disabled = !player.canChooseExact;
    this.input("recorded").checked = player.recorded;
    this.input("comparing").checked = player.comparing;
    this.input("comparing").closest<HTMLElement>("label")!.hidden = !player.hasAttribute("recordings");
    this.comparison.refresh();
    this.input("figures").checked = !this.part(".figures").hidden;
    this.field("menu").setAttribute("aria-expanded", String(!this.part(".menu").hidden));
    this.legend.refresh();
    this.timeline.refresh();
    this.sound.refresh();
  }

  private async enterXr(mode: "immersive-vr" | "immersive-ar"): Promise<void> {
    try {
      await this.player.enterXr(mode);
    } catch (error) {
      this.notices.say(error instanceof Error ? error.message : String(error));
    }
  }

  /** Shows what can be entered; a headset may be plugged in later. */
  private async offerXr(): Promise<void> {
    for (const [name, mode] of [["vr", "immersive-vr"], ["ar", "immersive-ar"]] as const) {
      this.field(name).hidden = !((await navigator.xr?.isSessionSupported(mode).catch(() => false)) ?? false);
    }
  }

  private toggle(selector: string): void {
    const panel = this.part(selector);
    const hide = !panel.hidden;
    const { activeElement } = this.root;
    if (!hide) this.opener = activeElement instanceof HTMLElement ? activeElement : this.player;
    this.closeAll();
    panel.hidden = hide;
    if (!hide) this.hint(""); // it would shine through
    if (!hide) panel.querySelector<HTMLElement>("button, select")?.focus();
    this.refresh();
  }

  /** The bar shows while something moves, and goes when a playing picture is left alone. */
  private awake(): void {
    this.root.host.classList.remove("idle");
    clearTimeout(this.idleTimer);
    this.idleTimer = window.setTimeout(() => {
      const open = this.closers.some((panel) => !panel.hidden);
      if (!open && !this.player.paused) this.root.host.classList.add("idle");
    }, IDLE_MS);
  }

  private part(selector: string): HTMLElement {
    return this.root.querySelector<HTMLElement>(selector)!;
  }
  private field(name: string): HTMLElement {
    return this.part(`[name="${name}"]`);
  }
  private select(name: string): HTMLSelectElement {
    return this.field(name) as HTMLSelectElement;
  }
  private input(name: string): HTMLInputElement {
    return this.field(name) as HTMLInputElement;
  }
}

/** Shows a value that a page may have set to what is not among those offered. */
function choose(select: HTMLSelectElement, value: number, text: string): void {
  select.value = String(value);
  if (select.selectedIndex >= 0) return;
  const own = select.querySelector<HTMLOptionElement>(".own") ?? select.appendChild(Object.assign(new Option(), { className: "own" }));
  Object.assign(own, { text, value: String(value), selected: true });
}
