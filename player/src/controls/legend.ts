/** What the colours of an overlay mean. */
import type { Overlay, PlayerApi } from "../player_api";
import { ownMarkup } from "../trusted";

const LEGENDS: Readonly<Record<Overlay, string>> = {
  none: "",
  changes: legend(["now", "changed in this frame"], ["past", "up to 12 frames ago"], ["still", "unchanged"]),
  motion: legend(["moving", "changed since the keyframe"], ["still", "never"]),
};

function legend(...rows: readonly (readonly [string, string])[]): string {
  return rows.map(([colour, text]) => `<span><i class="${colour}"></i>${text}</span>`).join("");
}

export class Legend {
  #shown: Overlay = "none";

  constructor(
    private readonly player: PlayerApi,
    private readonly panel: HTMLElement,
  ) {}

  refresh(): void {
    const { overlay } = this.player;
    if (overlay === this.#shown) return;
    this.#shown = overlay;
    this.panel.innerHTML = ownMarkup(LEGENDS[overlay]);
    this.panel.hidden = overlay === "none";
  }
}
