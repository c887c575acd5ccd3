/** A source that is still being written: it is looked at every second, until it is whole. */
const FOLLOW_MS = 1000;

export class Following {
  #timer = 0;

  constructor(private readonly look: () => void) {}

  /** It was looked at, or is about to be. */
  goOn(): void {
    this.end();
    this.#timer = window.setTimeout(this.look, FOLLOW_MS);
  }

  end(): void {
    clearTimeout(this.#timer);
  }
}
