/** Sound, where the stream has any: the script that plays it comes then. */
import type { Pose } from "../geometry/poses";
import { poseOf } from "../geometry/poses";
import type { FromWorker, ToWorker } from "../messages";
import type { StreamHeader } from "../scene";
import type { Speaker } from "./speaker";

/** What is known of the pictures when sound is kept in step with them. */
export interface Place {
  readonly position: number;
  readonly frameCount: number;
  readonly rate: number;
  readonly complete: boolean;
}

export class LateSound {
  private speaker: Speaker | null = null;
  private opened: StreamHeader | null = null;
  private level = 1;
  private silent = false;

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

  open(header: StreamHeader): void {
    if (header.sound.length === 0) return;
    if (!("AudioDecoder" in globalThis)) {
      this.say(isSecureContext ? "this browser does not play the stream's sound" : "browsers play a stream's sound only to pages of https, or of this machine");
      return;
    }
    this.opened = header;
    import("./index").then(
      ({ Speaker }) => {
        if (this.opened !== header) return;
        this.speaker = new Speaker(header.sound, header.fps!, (from, to, request) => {
          this.send({ type: "sound", from, to, request });
        });
        this.speaker.hearFrom(poseOf(header.cameras[0]).centre);
        this.adjust();
      },
      (error: unknown) => {
        this.say(`the stream's sound cannot be played: ${error instanceof Error ? error.message : String(error)}`);
      },
    );
  }

  /** Playing is asked for, mostly by a click. */
  begin(): void {
    this.speaker?.begin();
  }

  elapsed(): number | null {
    return this.speaker?.elapsed() ?? null;
  }

  keep({ position, frameCount, rate, complete }: Place): void {
    // A frame's sound is known when the next one has come.
    this.speaker?.keep(position, complete ? frameCount : frameCount - 1, rate);
  }

  rest(): void {
    this.speaker?.rest();
  }

  listen(pose: Pose): void {
    this.speaker?.listen(pose);
  }

  receive({ request, frames }: Extract<FromWorker, { type: "sound" }>): void {
    void this.speaker?.take(request, frames);
  }

  close(): void {
    this.opened = null;
    this.speaker?.close();
    this.speaker = null;
  }

  private adjust(): void {
    if (this.speaker !== null) this.speaker.volume = this.silent ? 0 : this.level;
  }
}
