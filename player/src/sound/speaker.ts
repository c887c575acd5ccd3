/**
 * The stream's sound: pieces of half a second, decoded ahead and put on the clock of Web Audio, which pictures then follow.
 *
 * Sound that comes from somewhere in the scene is heard from there (`listen`); all tracks play together.
 */
import type { Pose } from "../geometry/poses";
import { length, minus, times, type Vector } from "../geometry/vectors";
import type { Span } from "../player_api";
import type { SoundFrame, SoundTrack } from "../scene";
import { decoded } from "./decoding";
import { RATE, frameStart, framesBefore } from "../container/sound";
import { put, runsOf } from "./runs";

const PIECE_SECONDS = 0.5;
const AHEAD_SECONDS = 1.5;
/** How far sound and pictures may be apart before sound begins anew. */
const SLACK_SECONDS = 0.06;
/** From when the first piece is put on the clock until it begins: browsers' clocks go on by up to 40 ms at once, which would be cut off. */
const LEAD_SECONDS = 0.05;
/** Speeds at which anything is to be understood. */
const [SLOWEST, FASTEST] = [0.25, 4];

/** Asks for the sound of frames; `Speaker.take` gets them under the same number. */
export type AskForSound = (from: number, to: number, request: number) => void;

/** At `at` of the context's seconds, `media` seconds of the stream are heard, at this speed. */
interface Anchor {
  /** null: the first piece is still to come, and decides. */
  at: number | null;
  readonly media: number;
  readonly rate: number;
  /** What goes out is heard so much later. */
  readonly latency: number;
  /** Frames that are heard again and again; seconds of the stream count on through them. */
  repeated: Span | null;
}

/** Frames that were asked for, and the second at which they are heard. */
interface Piece {
  readonly from: number;
  readonly to: number;
  readonly media: number;
}

export class Speaker {
  private readonly context = new AudioContext({ sampleRate: RATE });
  private readonly gain: GainNode;
  private readonly voices: AudioNode[];
  private readonly playing = new Set<AudioBufferSourceNode>();
  private anchor: Anchor | null = null;
  private lastTime: number | null = null;
  private refused = false;
  private taken = Promise.resolve();
  /** The frame up to which sound was asked for, counted on through what is repeated. */
  private asked = 0;
  private requests = 0;
  private readonly pending = new Map<number, Piece>();
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
    this.refused = false;
    this.context.resume().catch(() => (this.refused = true));
  };

  set volume(value: number) {
    this.gain.gain.value = value;
  }

  /** Whether the browser lets it sound. */
  get runs(): boolean {
    return this.context.state === "running";
  }

  /** Whether sound is about to begin: the context has leave to, or the first piece is on its way. */
  get starting(): boolean {
    if (this.runs) return this.anchor?.at === null;
    const { userActivation } = navigator as { readonly userActivation?: UserActivation };
    return !this.refused && userActivation?.hasBeenActive !== false;
  }

  /** Seconds that have passed since this was asked last; null while nothing sounds. */
  elapsed(): number | null {
    const at = this.anchor?.at ?? null;
    if (at === null || !this.runs) return null;
    const since = this.lastTime ?? at;
    this.lastTime = Math.max(since, this.context.currentTime);
    return this.lastTime - since;
  }

  /**
   * Keeps in step with pictures: their position in frames, of how many there is sound, their speed, and which frames are repeated.
   * Sound that begins waits for its first piece, as pictures should, so that nothing of it is lost.
   */
  keep(position: number, frameCount: number, rate: number, repeated: Span | null): void {
    if (!this.runs || rate < SLOWEST || rate > FASTEST) {
      this.rest();
      return;
    }
    const media = position / this.fps;
    const anchor = this.fitting(media, rate, repeated) ?? this.newAnchor(media, rate, repeated);
    const heard = anchor.at === null ? anchor.media : this.heardAt(this.context.currentTime, anchor.at, anchor);
    const step = Math.max(1, Math.round(PIECE_SECONDS * this.fps));
    while (this.asked / this.fps < heard + AHEAD_SECONDS * rate) {
      const [from, passed] = folded(this.asked, repeated);
      const to = Math.min(from + step, frameCount, repeated !== null && from < repeated[1] ? repeated[1] : Infinity);
      if (from >= to) break;
      this.pending.set(++this.requests, { from, to, media: (frameStart(from, this.fps) + frameStart(passed, this.fps)) / RATE });
      this.ask(Math.max(0, from - framesBefore(this.fps)), to, this.requests);
      this.asked += to - from;
    }
    if (anchor.at === null && this.pending.size === 0) anchor.at = this.soon(anchor.latency); // there is nothing to wait for
  }

  /** Silence, until there is something to keep in step with. */
  rest(): void {
    this.anchor = this.lastTime = null;
    this.pending.clear();
    for (const source of this.playing) source.stop();
    this.playing.clear();
  }

  /** Frames that were asked for. Pieces go on the clock one after the other: the first one decides when. */
  take(request: number, frames: readonly SoundFrame[]): Promise<void> {
    return (this.taken = this.taken.catch(() => undefined).then(() => this.play(request, frames)));
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

  /** The anchor, where what is heard by it is what these pictures show; null: sound has to begin anew. */
  private fitting(media: number, rate: number, repeated: Span | null): Anchor | null {
    const { anchor } = this;
    if (anchor === null || anchor.rate !== rate) return null;
    const end = Math.min(endOf(anchor.repeated), endOf(repeated));
    if (this.asked > end && String(anchor.repeated) !== String(repeated)) return null; // what was asked for is another pass
    anchor.repeated = repeated;
    if (anchor.at === null) {
      // Pictures that did not wait go on without what they have passed.
      if (Math.abs(media - anchor.media) <= SLACK_SECONDS) return anchor;
      this.lastTime = this.context.currentTime;
      anchor.at = this.lastTime - (media - anchor.media) / rate;
      return anchor;
    }
    let apart = this.heardAt(this.context.currentTime, anchor.at, anchor) - media;
    if (repeated !== null) {
      const pass = (repeated[1] - repeated[0]) / this.fps;
      apart -= pass * Math.round(apart / pass);
    }
    return Math.abs(apart) > SLACK_SECONDS ? null : anchor;
  }

  private newAnchor(media: number, rate: number, repeated: Span | null): Anchor {
    this.rest();
    this.asked = Math.floor(media * this.fps + 1e-6);
    // Whole samples, and one latency, though browsers measure it again and again, so that pieces meet without a click.
    const [start, latency] = [media, this.context.outputLatency || 0].map((seconds) => Math.round(seconds * RATE) / RATE);
    return (this.anchor = { at: null, media: start, rate, latency, repeated });
  }

  /** Seconds of the stream; before it begins, those with which it will. */
  private heardAt(time: number, at: number, { media, rate }: Anchor): number {
    return media + Math.max(0, time - at) * rate;
  }

  /** When what is put on the clock now can be heard, in whole samples. */
  private soon(latency: number): number {
    return Math.ceil((this.context.currentTime + latency + LEAD_SECONDS) * RATE) / RATE;
  }

  private async play(request: number, frames: readonly SoundFrame[]): Promise<void> {
    const asked = this.pending.get(request);
    const { anchor } = this;
    if (asked === undefined || anchor === null) return;
    const pieces = await Promise.all(this.tracks.map(({ channels }, track) => this.decoded(frames, track, channels, asked)));
    if (anchor !== this.anchor) return; // somebody went elsewhere meanwhile
    this.pending.delete(request);
    anchor.at ??= this.soon(anchor.latency);
    for (const [track, piece] of pieces.entries()) if (piece !== null) this.schedule(piece, asked.media, track, anchor.at, anchor);
  }

  /** Samples of each channel; null where the track has none there. */
  private async decoded(frames: readonly SoundFrame[], track: number, channels: number, { from, to }: Piece): Promise<Float32Array<ArrayBuffer>[] | null> {
    const [start, end] = [frameStart(from, this.fps), frameStart(to, this.fps)];
    const piece = Array.from({ length: channels }, () => new Float32Array(end - start));
    const runs = runsOf(frames, track, this.fps);
    for (const run of runs) {
      const samples = await decoded(run, channels);
      piece.forEach((channel, index) => { put(channel, start, run, samples[index]); });
    }
    return runs.length > 0 ? piece : null;
  }

  private schedule(piece: readonly Float32Array<ArrayBuffer>[], media: number, track: number, at: number, anchor: Anchor): void {
    const buffer = this.context.createBuffer(piece.length, piece[0].length, RATE);
    piece.forEach((channel, index) => { buffer.copyToChannel(channel, index); });
    const source = this.context.createBufferSource();
    source.buffer = buffer;
    source.playbackRate.value = anchor.rate;
    source.connect(this.voices[track]);
    const when = at - anchor.latency + (media - anchor.media) / anchor.rate;
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
    const positions = this.tracks.flatMap(({ position }) => (position === null ? [] : [position]));
    return this.placed.map((panner, index) => [panner, positions[index]] as const);
  }
}

/** A frame that is counted on through what is repeated: which it is, and how many frames were passed in earlier passes. */
function folded(frame: number, repeated: Span | null): readonly [frame: number, passed: number] {
  if (repeated === null || frame < repeated[1]) return [frame, 0];
  const [from, to] = repeated;
  const passed = (to - from) * (1 + Math.floor((frame - to) / (to - from)));
  return [frame - passed, passed];
}

function endOf(repeated: Span | null): number {
  return repeated?.[1] ?? Infinity;
}
