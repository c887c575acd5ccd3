/** Sound, where the stream has any: the script that plays it comes then. */
import type { Pose } from "../geometry/poses";
import { poseOf } from "../geometry/poses";
import type { FromWorker, ToWorker } from "../messages";
import type { Span } from "../player_api";
import type { StreamHeader } from "../scene";
import type { Speaker } from "./speaker";

/** So long pictures wait for sound that is about to begin. */
const PATIENCE_MS = 500;

/** What is known of the pictures when sound is kept in step with them. */
export interface PictureTime {
  readonly position: number;
  readonly frameCount: number;
  readonly rate: number;
  readonly complete: boolean;
  readonly repeated: Span | null;
}

export class LateSound {
  private speaker: Speaker | null = null;
  private opened: StreamHeader | null = null;
  private level = 1;
  private silent = false;
  /** Whether playing was asked for before the script was there. */
  private begun = false;
  /** Since when pictures wait; null: they do not. */
  private waitsSince: number | null = null;
  /** Whether they have waited in vain, and nothing has sounded since. */
  private inVain = false;

  constructor(
    private readonly send: (message: ToWorker) => void,
    private readonly say: (text: string) => void,
  ) {}

  get volume(): number {
    return this.level;
  }
  set volume(value: number) {
    if (!(value >= 0 && value <= 1)) throw new RangeError("volume must be from 0 to 1");
    this.level = value;
    this.adjust();
  }
  get muted(): boolean {
    return this.silent;
  }
  set muted(value: boolean) {
    this.silent = value;
    this.adjust();
  }

  /** Whether anybody can hear it while it plays. */
  get audible(): boolean {
    return this.speaker?.runs === true && !this.silent && this.level > 0;
  }

  open(header: StreamHeader): void {
    if (header.sound.length === 0) return;
    if (!("AudioDecoder" in globalThis)) {
      this.say(isSecureContext ? "this browser does not play the stream's sound" : "browsers play a stream's sound only to pages of https, or of this machine");
      return;
    }
    this.opened = header;
    this.start(header).catch((error: unknown) => {
      this.opened = null;
      this.say(`the stream's sound cannot be played: ${error instanceof Error ? error.message : String(error)}`);
    });
  }

  /** Playing is asked for, mostly by a click. */
  begin(): void {
    this.begun = true;
    this.speaker?.begin();
  }

  /** Seconds that have passed by the clock of the sound: none while it is about to begin; null: there is no sound. */
  elapsed(): number | null {
    const passed = this.speaker?.elapsed() ?? null;
    if (passed !== null) {
      this.waitsSince = null;
      this.inVain = false;
      return passed;
    }
    const soon = this.speaker === null ? this.opened !== null : this.speaker.starting;
    const now = performance.now();
    this.waitsSince = soon ? (this.waitsSince ?? now) : null;
    this.inVain ||= soon && now - this.waitsSince! > PATIENCE_MS;
    return soon && !this.inVain ? 0 : null;
  }

  keep({ position, frameCount, rate, complete, repeated }: PictureTime): void {
    // A frame's sound is known when the next one has come.
    this.speaker?.keep(position, complete ? frameCount : frameCount - 1, rate, repeated);
  }

  rest(): void {
    this.waitsSince = null;
    this.speaker?.rest();
  }

  listen(pose: Pose): void {
    this.speaker?.listen(pose);
  }

  receive({ request, frames }: Extract<FromWorker, { type: "sound" }>): void {
    this.speaker?.take(request, frames).catch(() => undefined); // a piece that cannot be played is silence
  }

  close(): void {
    this.opened = this.waitsSince = null;
    this.begun = this.inVain = false;
    this.speaker?.close();
    this.speaker = null;
  }

  private async start(header: StreamHeader): Promise<void> {
    const { Speaker } = await import("./index");
    if (this.opened !== header) return;
    const speaker = new Speaker(header.sound, header.fps!, (from, to, request) => {
      this.send({ type: "sound", from, to, request });
    });
    speaker.hearFrom(poseOf(header.cameras[0]).centre);
    this.speaker = speaker;
    this.adjust();
    if (this.begun) speaker.begin();
  }

  private adjust(): void {
    if (this.speaker !== null) this.speaker.volume = this.silent ? 0 : this.level;
  }
}
