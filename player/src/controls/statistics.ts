/** The panel of figures: what is drawn, what it took, what the stream's packet said. */
import type { PlayerApi } from "../player_api";
import { bytesText, countText } from "./time_text";

const REFRESH_MS = 200;

export class Statistics {
  private shownAt = 0;

  constructor(
    private readonly player: PlayerApi,
    private readonly panel: HTMLElement,
  ) {}

  tick(now: number): void {
    if (this.panel.hidden || now - this.shownAt < REFRESH_MS) return;
    this.shownAt = now;
    this.refresh();
  }

  refresh(): void {
    const rows = this.rows();
    this.panel.replaceChildren(
      ...rows.flatMap(([name, value]) => {
        const [term, text] = [document.createElement("dt"), document.createElement("dd")];
        term.textContent = name;
        text.textContent = value;
        return [term, text];
      }),
    );
  }

  private rows(): [string, string][] {
    const { info, figures, fps, frames } = this.player;
    if (info === null || figures === null) return [];
    const ms = (value: number): string => `${value < 10 ? value.toFixed(1) : value.toFixed(0)} ms`;
    const psnr = frames.psnr.get(info.frame);
    const rows: [string, string][] = [
      ["Pictures", `${figures.pictures} /s`],
      ["Size", `${figures.width} × ${figures.height}`],
      ["Gaussians", countText(info.count)],
      ["drawn", countText(figures.drawn)],
      ["Frame", `${info.frame}, ${info.kind ?? "damaged"}`],
      ["packet", bytesText(info.bytes)],
      ["changed", countText(info.changed)],
      ["new, gone", `${countText(info.added)}, ${countText(info.removed)}`],
    ];
    if (psnr !== undefined) rows.push(["PSNR", `${psnr.toFixed(2)} dB`]);
    rows.push(
      ["Read", bytesText(figures.bytesRead)],
      ["Stream", rateText(frames.bytes, frames.count, fps)],
      ["Decode", ms(info.decodeMs)],
      ["pack", ms(info.packMs)],
      ["sort", ms(figures.sortMs)],
      ["upload", ms(figures.uploadMs)],
      ["draw", ms(figures.drawMs)],
    );
    return rows;
  }
}

function rateText(bytes: Uint32Array, count: number, fps: number): string {
  let sum = 0;
  for (let frame = 0; frame < count; frame++) sum += bytes[frame];
  return count > 0 ? `${((sum * 8 * fps) / count / 1e6).toFixed(2)} Mbit/s` : "";
}
