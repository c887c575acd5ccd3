/** Web Audio and WebCodecs as far as sound needs them, in Node: a clock that tests turn, and what would be heard at a time. */
import { setMaxListeners } from "node:events";

export interface Source {
  readonly when: number;
  readonly offset: number;
  readonly rate: number;
  readonly samples: Float32Array;
  /** What it goes through. */
  readonly node: unknown;
  stopped: number;
  readonly end: () => void;
}

export class FakeContext {
  static made: FakeContext[] = [];
  static fails = false;
  state: AudioContextState = "running";
  currentTime = 0;
  outputLatency = 0;
  resumed = 0;
  readonly destination = {};
  readonly sources: Source[] = [];
  readonly gain = { gain: { value: 1 }, connect: () => undefined };
  readonly listener = Object.fromEntries(["position", "forward", "up"].flatMap((name) => ["X", "Y", "Z"].map((axis) => [name + axis, { value: 0 }])));
  /** What resuming comes to. */
  onResume: () => Promise<void> = () => Promise.resolve();

  constructor() {
    if (FakeContext.fails) throw new DOMException("there is no sound card", "NotSupportedError");
    FakeContext.made.push(this);
  }

  createGain(): unknown {
    return this.gain;
  }

  createBuffer(channels: number, length: number): unknown {
    const samples = Array.from({ length: channels }, () => new Float32Array(length));
    return { samples, copyToChannel: (from: Float32Array, index: number) => { samples[index].set(from); } };
  }

  createBufferSource(): unknown {
    const playbackRate = { value: 1 };
    const source = {
      playbackRate,
      buffer: null as { readonly samples: Float32Array[] } | null,
      onended: null as (() => void) | null,
      started: null as Source | null,
      node: null as unknown,
      connect: (node: unknown) => {
        source.node = node;
      },
      start: (when: number, offset: number) => {
        // What should have begun begins now.
        source.started = { when: Math.max(when, this.currentTime), offset, node: source.node, rate: playbackRate.value, samples: source.buffer!.samples[0], stopped: Infinity, end: () => source.onended?.() };
        this.sources.push(source.started);
      },
      stop: () => {
        source.started!.stopped = this.currentTime;
      },
    };
    return source;
  }

  resume(): Promise<void> {
    this.resumed++;
    return this.onResume();
  }

  close(): Promise<void> {
    this.state = "closed";
    return Promise.resolve();
  }

  /** The sum of all samples that go out at a time. */
  heard(time: number): number {
    let sum = 0;
    for (const { when, offset, rate, samples, stopped } of this.sources) {
      if (time < when - 1e-9 || time >= stopped) continue;
      sum += samples[Math.floor(((time - when) * rate + offset) * 48_000 + 1e-3)] ?? 0;
    }
    return sum;
  }
}

/** A panner that notes where it is. */
export class FakePanner {
  static made: FakePanner[] = [];
  refDistance = 1;
  constructor(
    _: unknown,
    readonly options: Readonly<Record<string, unknown>>,
  ) {
    FakePanner.made.push(this);
  }
  connect(): void {
    // Nothing is heard of it.
  }
}

/** Decodes a block to 960 samples of the value of its first byte. `Decoders.held`: until tests let it go on. */
export const Decoders: { held: Promise<void> | null } = { held: null };
class FakeDecoder {
  state = "unconfigured";
  constructor(private readonly host: { readonly output: (data: unknown) => void }) {}
  configure(): void {
    this.state = "configured";
  }
  decode({ timestamp, data }: { readonly timestamp: number; readonly data: Uint8Array }): void {
    this.host.output({ timestamp, numberOfFrames: 960, numberOfChannels: 1, copyTo: (part: Float32Array) => part.fill(data[0]), close: () => undefined });
  }
  async flush(): Promise<void> {
    await Decoders.held;
  }
  close(): void {
    this.state = "closed";
  }
}

const page = new EventTarget();
setMaxListeners(0, page); // a test makes many speakers

Object.assign(globalThis, {
  AudioContext: FakeContext,
  AudioDecoder: FakeDecoder,
  PannerNode: FakePanner,
  EncodedAudioChunk: function (this: object, init: object) {
    Object.assign(this, init);
  },
  document: page,
  isSecureContext: true,
});
// Node 21 has a navigator of its own.
Object.defineProperty(globalThis, "navigator", { value: { userActivation: { hasBeenActive: true } }, configurable: true });
