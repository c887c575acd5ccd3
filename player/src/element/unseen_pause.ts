/** A player that nobody sees pauses, and goes on when it is seen again. */
import type { PlayerApi } from "../player_api";

export class UnseenPause {
  /** Whether playing goes on once the player is seen again. */
  #pending = false;

  constructor(
    private readonly player: Pick<PlayerApi, "paused" | "play" | "pause">,
    private readonly unseen: () => boolean,
  ) {}

  /** Somebody has played or paused, or another stream is opened. */
  forget(): void {
    this.#pending = false;
  }

  /** Whether it is seen, or heard, may have changed. */
  update(): void {
    if (!this.unseen()) {
      if (this.#pending) this.player.play().catch(() => undefined);
    } else if (!this.player.paused) {
      this.player.pause();
      this.#pending = true;
    }
  }

  /** Has playing by itself wait until somebody sees it; whether it has to. */
  holdBack(): boolean {
    this.#pending ||= this.unseen();
    return this.#pending;
  }
}
