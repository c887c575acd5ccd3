/** Mute and volume, in the bar of a stream that has sound. */
import { icon } from "./icons";
import type { PlayerApi } from "../player_api";
import { ownMarkup } from "../trusted";

export class SoundControls {
  private readonly button = document.createElement("button");
  private readonly slider = document.createElement("input");
  private shown = "";

  constructor(
    private readonly player: PlayerApi,
    private readonly holder: HTMLElement,
  ) {
    this.button.type = "button";
    this.button.name = "mute";
    Object.assign(this.slider, { type: "range", name: "volume", min: "0", max: "1", step: "0.05" });
    this.slider.setAttribute("aria-label", "Volume");
    this.button.addEventListener("click", () => {
      player.muted = !player.muted;
    });
    this.slider.addEventListener("input", () => {
      player.volume = Number(this.slider.value);
      player.muted = player.volume === 0;
    });
    holder.append(this.button, this.slider);
  }

  refresh(): void {
    const { header, muted, volume } = this.player;
    this.holder.hidden = (header?.sound.length ?? 0) === 0;
    this.slider.value = String(muted ? 0 : volume);
    const name = muted ? "muted" : "sound";
    if (name === this.shown) return;
    this.shown = name;
    this.button.innerHTML = ownMarkup(icon(name));
    this.button.setAttribute("aria-label", muted ? "Sound on" : "Mute");
  }
}
