/**
 * The timeline: a bar for every frame, as high as its packet is long (on a logarithmic scale), keyframes in colour: a
 * stream's life at a glance, and the slider to move in it. PSNR is a line over it where the stream tells it.
 */
import type { PlayerApi } from "../player_api";
import { Thumbnails } from "./thumbnails";
import { bytesText, timeText } from "./time_text";

const SMALLEST_PACKET = 24;
/** Of a bar, in pixels of the page. */
const WIDEST = 12;

export class Timeline {
  private readonly canvas = document.createElement("canvas");
  private readonly tip = document.createElement("div");
  private readonly caption = document.createElement("div");
  private readonly thumbnails: Thumbnails;
  private drawnState = "";
  private hovered = -1;
  private marked: number | null = null;

  constructor(
    private readonly player: PlayerApi,
    private readonly track: HTMLElement,
  ) {
    this.tip.className = "tip";
    this.tip.hidden = true;
    this.thumbnails = new Thumbnails(player);
    this.tip.append(this.thumbnails.canvas, this.caption);
    track.append(this.canvas, this.tip);
    track.addEventListener("pointerdown", (event) => {
      track.setPointerCapture(event.pointerId);
      this.seekTo(event);
    });
    track.addEventListener("pointermove", (event) => {
      this.hover(event);
      if (track.hasPointerCapture(event.pointerId)) this.seekTo(event);
    });
    track.addEventListener("pointerleave", () => {
      this.hovered = -1;
      this.tip.hidden = true;
    });
  }

  /** Shows where a loop is to begin; null: nowhere. */
  mark(frame: number | null): void {
    this.marked = frame;
  }

  /** Draws what has changed; cheap when nothing has. */
  refresh(): void {
    const { player, track, canvas } = this;
    const count = player.frames.count;
    const frame = player.currentFrame;
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [Math.round(track.clientWidth * ratio), Math.round(track.clientHeight * ratio)];
    const colours = getComputedStyle(track);
    const state = [count, frame, width, height, player.frames.psnr.size, player.bufferedFrames, player.refinedFrames, player.range, this.marked, colours.color].join();
    if (state === this.drawnState || width === 0) return;
    this.drawnState = state;
    [canvas.width, canvas.height] = [width, height];
    this.draw(canvas.getContext("2d")!, width, height, ratio, colours);
    const time = timeText(player.currentTime);
    track.setAttribute("aria-valuemax", String(Math.max(0, count - 1)));
    track.setAttribute("aria-valuenow", String(frame));
    track.setAttribute("aria-valuetext", count > 0 ? `${time}, frame ${frame} of ${count}` : "nothing yet");
  }

  private draw(
    context: CanvasRenderingContext2D,
    width: number,
    height: number,
    ratio: number,
    colours: CSSStyleDeclaration,
  ): void {
    const { frames, currentFrame, bufferedFrames, refinedFrames } = this.player;
    const { count } = frames;
    if (count === 0) return;
    const [ink, accent] = [colours.color, colours.getPropertyValue("--accent")];
    const columns = Math.min(count, Math.floor(width / 2));
    const step = width / columns;
    const gap = step > 3 ? Math.max(1, step - WIDEST * ratio, Math.min(2 * ratio, step / 4)) : 0;
    let most = SMALLEST_PACKET;
    for (let frame = 0; frame < count; frame++) most = Math.max(most, frames.bytes[frame]);
    const span = Math.log2(most / SMALLEST_PACKET) || 1;
    const base = Math.max(1, Math.round(2 * ratio));
    context.fillStyle = ink;
    context.globalAlpha = 0.18;
    context.fillRect(0, height - base, width, base);
    context.globalAlpha = 0.3;
    for (const spans of [bufferedFrames, refinedFrames]) {
      for (const [from, to] of spans) context.fillRect((from / count) * width, height - base, ((to - from) / count) * width, base);
    }
    context.globalAlpha = 0.6;
    context.fillRect(0, height - base, ((currentFrame + 0.5) / count) * width, base);
    const looped = this.player.range ?? (this.marked === null ? null : [this.marked, this.marked + 1]);
    if (looped !== null) {
      context.fillStyle = accent;
      context.globalAlpha = 0.25;
      const [from, to] = looped.map((at) => (Math.min(at, count) / count) * width) as [number, number];
      context.fillRect(from, 0, to - from, height);
    }
    for (let column = 0; column < columns; column++) {
      const from = Math.floor((column * count) / columns);
      const to = Math.floor(((column + 1) * count) / columns);
      let [bytes, key] = [0, false];
      for (let frame = from; frame < to; frame++) {
        bytes = Math.max(bytes, frames.bytes[frame]);
        key ||= frames.kinds[frame] === 0;
      }
      const share = Math.max(0, Math.log2(Math.max(bytes, 1) / SMALLEST_PACKET)) / span;
      const bar = Math.max(base, share * height);
      context.globalAlpha = from <= currentFrame ? 0.95 : key ? 0.55 : 0.3;
      context.fillStyle = key ? accent : ink;
      context.fillRect(column * step + gap / 2, height - bar, step - gap, bar);
    }
    this.drawPsnr(context, width, height, colours.getPropertyValue("--line"));
    context.globalAlpha = 1;
    context.fillStyle = ink;
    const head = ((currentFrame + 0.5) / count) * width;
    context.fillRect(Math.round(head - ratio), 0, Math.round(2 * ratio), height);
  }

  private drawPsnr(context: CanvasRenderingContext2D, width: number, height: number, colour: string): void {
    const { psnr, count } = this.player.frames;
    if (psnr.size < 2) return;
    const values = [...psnr].sort(([a], [b]) => a - b);
    const low = values.reduce((least, [, value]) => Math.min(least, value), Infinity);
    const high = values.reduce((most, [, value]) => Math.max(most, value), -Infinity);
    context.globalAlpha = 0.9;
    context.strokeStyle = colour;
    context.lineWidth = Math.max(1, height / 24);
    context.beginPath();
    for (const [frame, value] of values) {
      const share = high > low ? (value - low) / (high - low) : 0.5;
      context.lineTo(((frame + 0.5) / count) * width, height * (0.9 - 0.8 * share));
    }
    context.stroke();
  }

  private frameAt(event: PointerEvent): number {
    const { left, width } = this.track.getBoundingClientRect();
    const { count } = this.player.frames;
    return Math.max(0, Math.min(count - 1, Math.floor(((event.clientX - left) / width) * count)));
  }

  private seekTo(event: PointerEvent): void {
    const frame = this.frameAt(event);
    if (this.player.frames.count > 0 && frame !== this.player.currentFrame) this.player.currentFrame = frame;
  }

  private hover(event: PointerEvent): void {
    const { frames, fps, header, refinedFrames } = this.player;
    if (frames.count === 0) return;
    const frame = this.frameAt(event);
    if (frame !== this.hovered) {
      this.hovered = frame;
      const psnr = frames.psnr.get(frame);
      const parts = [timeText(frame / fps), `frame ${frame}`, frames.kind(frame) ?? "lost", bytesText(frames.bytes[frame])];
      if (header !== null && header.layers.length > 0) {
        parts.push(refinedFrames.some(([from, to]) => from <= frame && frame < to) ? "all layers" : "base");
      }
      if (psnr !== undefined) parts.push(`${psnr.toFixed(2)} dB`);
      this.caption.textContent = parts.join("  ·  ");
    }
    this.thumbnails.show(frame);
    const { left, width } = this.track.getBoundingClientRect();
    this.tip.hidden = false;
    const half = this.tip.offsetWidth / 2;
    // In the track's own pixels, which a page may show larger or smaller; within the player, since the track may be short.
    const scale = this.track.clientWidth / width;
    const around = this.player.getBoundingClientRect();
    const [first, at, last] = [around.left, event.clientX, around.right].map((x) => (x - left) * scale);
    this.tip.style.left = `${Math.max(first + half, Math.min(last - half, at))}px`;
  }
}
