/**
 * The stream's sound: pieces of half a second, decoded ahead and put on the clock of Web Audio, which pictures then follow.
 *
 * Sound that comes from somewhere in the scene is heard from there (`listen`); all tracks play together.
 */
import type { Pose } from "../geometry/poses";
import { length, minus, times, type Vector } from "../geometry/vectors";
import type { SoundFrame, SoundTrack } from "../scene";
import { decoded } from "./decoding";
import { RATE, frameStart, framesBefore } from "./packets";
import { put, runsOf } from "./runs";

const PIECE_SECONDS = 0.5;
const AHEAD_SECONDS = 1.5;
/** How far sound and pictures may be apart before sound begins anew. */
const SLACK_SECONDS = 0.06;
/** Speeds at which anything is to be understood. */
const [SLOWEST, FASTEST] = [0.25, 4];

/** Asks for the sound of frames; `Speaker.take` gets them under the same number. */
export type AskForSound = (from: number, to: number, request: number) => void;

/** At `at` of the context's seconds, `media` seconds of the stream are heard, at this speed. */
interface Anchor {
  readonly at: number;
  readonly media: number;
  readonly rate: number;
}

export class Speaker {
  private readonly context = new AudioContext({ sampleRate: RATE });
  private readonly gain: GainNode;
  private readonly voices: AudioNode[];
  private readonly playing = new Set<AudioBufferSourceNode>();
  private anchor: Anchor | null = null;
  private lastTime: number | null = null;
  /** The frame up to which sound was asked for. */
  private asked = 0;
  private requests = 0;
  private readonly pending = new Map<number, readonly [from: number, to: number]>();
  private placed: readonly PannerNode[] = [];

  constructor(
    private readonly tracks: readonly SoundTrack[],
    private readonly fps: number,
    private readonly ask: AskForSound,
  ) {
    this.gain = this.context.createGain();
    this.gain.connect(this.context.destination);
    this.voices = tracks.map(({ position }) => this.voice(position));
    for (const name of ["pointerdown", "keydown"]) document.addEventListener(name, this.begin);
  }

  /** Browsers let a page sound once somebody has touched it. */
  readonly begin = (): void => {
    this.context.resume().catch(() => undefined);
  };

  set volume(value: number) {
    this.gain.gain.value = value;
  }

  /** Seconds that have passed since this was asked last; null while nothing sounds. */
  elapsed(): number | null {
    if (this.anchor === null || this.context.state !== "running") return (this.lastTime = null);
    const { currentTime } = this.context;
    const passed = this.lastTime === null ? null : currentTime - this.lastTime;
    this.lastTime = currentTime;
    return passed;
  }

  /** Keeps in step with pictures: their place in frames, of how many there is sound, and their speed. */
  keep(position: number, frameCount: number, rate: number): void {
    if (this.context.state !== "running" || rate < SLOWEST || rate > FASTEST) {
      this.rest();
      return;
    }
    const media = position / this.fps;
    if (this.anchor === null || this.anchor.rate !== rate || Math.abs(this.heardAt(this.context.currentTime) - media) > SLACK_SECONDS) {
      this.rest();
      // Whole samples, so that pieces meet without a click.
      const at = Math.round(this.context.currentTime * RATE) / RATE;
      this.anchor = { at, media: Math.round(media * RATE) / RATE, rate };
      this.asked = Math.floor(position);
    }
    const step = Math.max(1, Math.round(PIECE_SECONDS * this.fps));
    while (this.asked < frameCount && this.asked / this.fps < media + AHEAD_SECONDS * rate) {
      const to = Math.min(this.asked + step, frameCount);
      this.pending.set(++this.requests, [this.asked, to]);
      this.ask(Math.max(0, this.asked - framesBefore(this.fps)), to, this.requests);
      this.asked = to;
    }
  }

  /** Silence, until there is something to keep in step with. */
  rest(): void {
    this.anchor = this.lastTime = null;
    this.pending.clear();
    for (const source of this.playing) source.stop();
    this.playing.clear();
  }

  /** Frames that were asked for. */
  async take(request: number, frames: readonly SoundFrame[]): Promise<void> {
    const span = this.pending.get(request);
    this.pending.delete(request);
    const { anchor } = this;
    if (span === undefined || anchor === null) return;
    const [start, end] = span.map((frame) => frameStart(frame, this.fps));
    for (const [track, { channels }] of this.tracks.entries()) {
      const piece = Array.from({ length: channels }, () => new Float32Array(end - start));
      const runs = runsOf(frames, track, this.fps);
      for (const run of runs) {
        const samples = await decoded(run, channels);
        piece.forEach((channel, index) => { put(channel, start, run, samples[index]); });
      }
      if (anchor !== this.anchor) return; // somebody went elsewhere meanwhile
      if (runs.length > 0) this.schedule(piece, start / RATE, track, anchor);
    }
  }

  /** Where the picture is seen from. */
  listen({ centre, axes }: Pose): void {
    if (this.placed.length === 0) return;
    const { listener } = this.context;
    const [forward, up] = [axes[2], times(axes[1], -1)];
    if ("positionX" in listener) {
      for (const [name, [x, y, z]] of [["position", centre], ["forward", forward], ["up", up]] as const) {
        [listener[`${name}X`].value, listener[`${name}Y`].value, listener[`${name}Z`].value] = [x, y, z];
      }
    } else {
      // Firefox has no other way.
      const old = listener as { setPosition(...at: number[]): void; setOrientation(...to: number[]): void };
      old.setPosition(...centre);
      old.setOrientation(...forward, ...up);
    }
  }

  /** `from`: where sound that has a place is as loud as it was recorded. */
  hearFrom(from: Vector): void {
    for (const [panner, position] of this.placedTracks()) panner.refDistance = Math.max(1e-6, length(minus(position, from)));
  }

  close(): void {
    for (const name of ["pointerdown", "keydown"]) document.removeEventListener(name, this.begin);
    this.rest();
    this.context.close().catch(() => undefined);
  }

  private heardAt(time: number): number {
    const { at, media, rate } = this.anchor!;
    return media + (time - at) * rate;
  }

  private schedule(piece: readonly Float32Array<ArrayBuffer>[], media: number, track: number, anchor: Anchor): void {
    const buffer = this.context.createBuffer(piece.length, piece[0].length, RATE);
    piece.forEach((channel, index) => { buffer.copyToChannel(channel, index); });
    const source = this.context.createBufferSource();
    source.buffer = buffer;
    source.playbackRate.value = anchor.rate;
    source.connect(this.voices[track]);
    // What goes out now is heard a little later.
    const latency = Math.round((this.context.outputLatency || 0) * RATE) / RATE;
    const when = anchor.at - latency + (media - anchor.media) / anchor.rate;
    const late = Math.max(0, this.context.currentTime - when);
    this.playing.add(source);
    source.onended = () => {
      this.playing.delete(source);
    };
    source.start(when + late, late * anchor.rate);
  }

  private voice(position: Vector | null): AudioNode {
    if (position === null) return this.gain;
    const [positionX, positionY, positionZ] = position;
    const panner = new PannerNode(this.context, { panningModel: "HRTF", positionX, positionY, positionZ });
    panner.connect(this.gain);
    this.placed = [...this.placed, panner];
    return panner;
  }

  private placedTracks(): (readonly [PannerNode, Vector])[] {
    const places = this.tracks.flatMap(({ position }) => (position === null ? [] : [position]));
    return this.placed.map((panner, index) => [panner, places[index]] as const);
  }
}
