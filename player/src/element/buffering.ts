/** Playing that waits for a frame that is late, until so much is there that it need not wait again at once. */
import type { Span } from "../player_api";
import type { Playback } from "./playback";
import type { SessionHost } from "./session_host";

/** After so long a frame that was asked for is late. */
const LATE_MS = 200;
/** After it had to wait, playing goes on when so much is there. */
const ENOUGH_SECONDS = 1;

export class Buffering {
  /** Whether playing waits for a frame that is late. */
  waiting = false;
  /** Whether people see that something is waited for. */
  #busy = false;
  #timer = 0;

  constructor(
    private readonly playback: Playback,
    private readonly host: Pick<SessionHost, "tell" | "busy">,
  ) {}

  /** A frame is asked for. */
  expect(): void {
    this.expectNone();
    this.#timer = window.setTimeout(() => {
      this.#late();
    }, LATE_MS);
  }

  /** It has come, or never will. */
  expectNone(): void {
    clearTimeout(this.#timer);
  }

  /** A picture was shown, which need not be the one that playing waits for. */
  shown(): void {
    if (!this.waiting) this.#setBusy(false);
  }

  /** `share` of what is waited for has come. `first`: there is no picture yet. */
  progress(share: number | null, first: boolean): void {
    if (this.#busy || first) this.host.busy(true, share);
  }

  /** Goes on if enough is there: bytes of frames `buffered`, and the picture of frame `shown`. */
  goOn(buffered: readonly Span[], shown: number | undefined): void {
    if (!this.waiting || !this.#enough(buffered, shown)) return;
    this.waiting = false;
    this.#setBusy(false);
    if (this.playback.playing) this.host.tell("playing");
  }

  /** Nothing is waited for any more. */
  end(): void {
    this.expectNone();
    this.waiting = false;
    this.#setBusy(false);
  }

  #late(): void {
    this.#setBusy(true);
    if (!this.playback.playing || this.waiting) return;
    this.waiting = true;
    this.host.tell("waiting");
  }

  #enough(buffered: readonly Span[], shown: number | undefined): boolean {
    const { due, fps, frameCount, rate } = this.playback;
    if (shown !== due) return false;
    const until = Math.min(frameCount, Math.ceil(due + ENOUGH_SECONDS * fps * rate));
    return buffered.some(([from, to]) => from <= due && to >= until);
  }

  #setBusy(on: boolean): void {
    this.#busy = on;
    this.host.busy(on, null);
  }
}
