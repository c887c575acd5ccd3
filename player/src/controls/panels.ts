/** The controls over the picture: the bar, its menu, help, figures and notices. They act through the player alone. */
import type { Overlay, PlayerApi } from "../player_api";
import { ownMarkup } from "../trusted";
import { adopt } from "../adopted_style";
import { cameraToLink, poseFile } from "./camera_text";
import { cameraNote } from "./camera_note";
import type { CropTool } from "./crop";
import { Comparison } from "./comparison";
import { icon } from "./icons";
import { playOrPause } from "./keys";
import { markup } from "./markup";
import style from "./style.css";
import { Statistics } from "./statistics";
import { Timeline } from "./timeline";
import { timeText } from "./time_text";
import { SoundControls } from "./sound_controls";

const IDLE_MS = 2600;
const NOTICE_MS = 2600;
const SPINNER_AFTER_MS = 250;
const FREE = "";
/** Pixels of the page: up to so many the bar is one row (style.css), and cameras are chosen in the menu. */
const NARROW = 520;

const LEGENDS: Readonly<Record<Overlay, string>> = {
  none: "",
  changes: legend(["now", "changed in this frame"], ["past", "up to 12 frames ago"], ["still", "unchanged"]),
  motion: legend(["moving", "changed since the keyframe"], ["still", "never"]),
};

function legend(...rows: readonly (readonly [string, string])[]): string {
  return rows.map(([colour, text]) => `<span><i class="${colour}"></i>${text}</span>`).join("");
}

export class Panels {
  private readonly timeline: Timeline;
  private readonly statistics: Statistics;
  private readonly comparison: Comparison;
  private readonly sound: SoundControls;
  private readonly closers: readonly HTMLElement[];
  private refreshing = false;
  private camerasOf: unknown = null;
  private warning: string | null = null;
  private noticeTimer = 0;
  private idleTimer = 0;
  private loadingTimer = 0;
  private shownBusy = false;
  private invited = false;
  /** The frame that a loop is to begin with, once its end is marked. */
  private marked: number | null = null;
  private crop: CropTool | null = null;
  /** What had the focus before a panel was opened. */
  private opener: HTMLElement;
  private legendOf: Overlay = "none";

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

  /** Says what is wrong for as long as it is; null when nothing is. */
  warn(text: string | null): void {
    if (text === this.warning) return;
    this.warning = text;
    this.say(text ?? "", text !== null);
  }

  /** Says, for a moment, what the picture of the camera that is looked through leaves out. */
  tellCamera(): void {
    const { header, camera } = this.player;
    const note = header === null || this.player.recorded ? null : cameraNote(header, camera);
    if (note !== null && this.warning === null) this.say(note, false);
  }

  /** Tells people once that the picture is theirs to turn. */
  invite(): void {
    if (this.invited || !this.player.controls || this.player.info === null) return;
    this.invited = true;
    this.hint(this.player.getAttribute("gestures") === "cooperative" ? "Use two fingers, or drag, to look around" : "Drag to look around");
  }

  /** Says something for a moment, unless something is wrong. */
  hint(text: string): void {
    if (this.warning === null) this.say(text, false);
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
    await this.save(this.player.capture(), `${this.player.camera || "view"}_${this.frameText()}.png`);
  }

  /** Gives what is made, once it is, to whoever looks at the page, as a file. */
  private async save(made: Promise<Blob>, name: string): Promise<void> {
    try {
      const link = document.createElement("a");
      link.href = URL.createObjectURL(await made);
      link.download = name;
      link.click();
      setTimeout(() => {
        URL.revokeObjectURL(link.href);
      }, 10_000);
    } catch (error) {
      this.say(error instanceof Error ? error.message : String(error), false);
    }
  }

  private frameText(): string {
    return String(this.player.info?.frame ?? 0).padStart(4, "0");
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
      ply: () => void this.save(this.player.ply(), `frame_${this.frameText()}.ply`),
      crop: () => void this.startCrop(),
      pose: () => void this.copyPose(),
      link: () => void this.copyLink(),
      embed: () => void this.copyEmbed(),
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
    this.select("camera").addEventListener("change", ({ target }) => {
      const { value } = target as HTMLSelectElement;
      if (value !== FREE) player.lookThrough(Number(value));
    });
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
    this.arrange();
    const [button, text] = player.paused ? (player.ended ? ["replay", "Play again"] : ["play", "Play"]) : ["pause", "Pause"];
    const play = this.part(".play");
    if (play.getAttribute("aria-label") !== text) {
      play.innerHTML = ownMarkup(icon(button as "play"));
      play.setAttribute("aria-label", text);
    }
    this.part(".start").hidden = player.controls || !player.paused || (player.info === null && player.preload !== "none");
    this.part(".now-at").textContent = player.header === null ? "" : timeText(player.currentTime);
    this.part(".of").textContent = player.header === null ? "" : ` / ${timeText(player.duration)}`;
    this.updateCameras();
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
    this.updateLegend();
    this.timeline.refresh();
    this.sound.refresh();
  }

  private arrange(): void {
    const [cameras, bar] = [this.part(".cameras"), this.part(".row")];
    const narrow = this.player.clientWidth <= NARROW;
    if (narrow === !bar.contains(cameras)) return;
    if (narrow) this.part(".menu").prepend(cameras);
    else this.field("menu").before(cameras);
  }

  private updateCameras(): void {
    const { player } = this;
    const select = this.select("camera");
    if (player.header !== this.camerasOf) {
      this.camerasOf = player.header;
      const free = new Option("free view", FREE, true, true);
      free.hidden = true;
      const rig = player.header?.cameras.map(({ name }, index) => {
        const held = player.header!.heldOut.includes(name) ? " (held out)" : "";
        return new Option(name + held, String(index));
      });
      select.replaceChildren(free, ...(rig ?? []));
    }
    const index = player.header?.cameras.findIndex(({ name }) => name === player.camera) ?? -1;
    select.value = index >= 0 ? String(index) : FREE;
  }

  private updateLegend(): void {
    const { overlay } = this.player;
    if (overlay === this.legendOf) return;
    this.legendOf = overlay;
    const legend = this.part(".legend");
    legend.innerHTML = ownMarkup(LEGENDS[overlay]);
    legend.hidden = overlay === "none";
  }

  private async copyPose(): Promise<void> {
    const camera = this.player.currentCamera();
    if (camera !== null) await this.copy(poseFile(camera), "Copied: save it as pose.json for decogs-decode --camera");
  }

  /** The address of this page at this view and frame. */
  private address(): string {
    const { view, currentFrame } = this.player;
    const address = new URL(location.href);
    if (view !== null) address.hash = `camera=${cameraToLink(view.pose, view.lens)}&frame=${currentFrame}`;
    return address.href;
  }

  private async copyLink(): Promise<void> {
    await this.copy(this.address(), "Copied: a link to this view and frame");
  }

  private async enterXr(mode: "immersive-vr" | "immersive-ar"): Promise<void> {
    try {
      await this.player.enterXr(mode);
    } catch (error) {
      this.say(error instanceof Error ? error.message : String(error), false);
    }
  }

  /** Shows what can be entered; a headset may be plugged in later. */
  private async offerXr(): Promise<void> {
    for (const [name, mode] of [["vr", "immersive-vr"], ["ar", "immersive-ar"]] as const) {
      this.field(name).hidden = !((await navigator.xr?.isSessionSupported(mode).catch(() => false)) ?? false);
    }
  }

  private async copyEmbed(): Promise<void> {
    const quoted = this.address().replace(/&/g, "&amp;").replace(/"/g, "&quot;");
    const frame = `<iframe src="${quoted}" title="Free-viewpoint video" style="border: 0; width: 100%; aspect-ratio: 16 / 9" allow="fullscreen; clipboard-write; xr-spatial-tracking"></iframe>`;
    await this.copy(frame, "Copied: code that shows this page in yours");
  }

  private async copy(text: string, done: string): Promise<void> {
    try {
      await navigator.clipboard.writeText(text);
      this.say(done, false);
    } catch {
      // A page without leave for the clipboard (plain http, a frame): the text can be copied by hand.
      window.prompt("Copy this:", text);
    }
  }

  /** A notice; one that does not stay goes by itself, and gives way to a warning that does. */
  private say(text: string, stays: boolean): void {
    clearTimeout(this.noticeTimer);
    const notice = this.part(".notice");
    notice.textContent = text;
    notice.hidden = text === "";
    notice.classList.toggle("warning", stays);
    if (stays || text === "") return;
    this.noticeTimer = window.setTimeout(() => {
      this.say(this.warning ?? "", this.warning !== null);
    }, NOTICE_MS);
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
