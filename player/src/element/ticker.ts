/** The window that shows an element: something is done before its next picture, when it is asked for. */

/** Seconds: what a window that was hidden has missed does not count. */
const LONGEST_STEP = 0.1;

export class Ticker {
  #document = document;
  #request = 0;
  #last = 0;

  /** `tick`: what is done, at a time in milliseconds, and how many seconds after the last one. */
  constructor(private readonly tick: (now: number, seconds: number) => void) {}

  /** Of the document that shows the element: another one may be hidden. */
  get window(): Window {
    return this.#document.defaultView ?? window;
  }

  /** The picture that is waited for; 0: none. */
  get request(): number {
    return this.#request;
  }

  wake(): void {
    if (this.#request === 0) this.#request = this.window.requestAnimationFrame(this.#tick);
  }

  /** What another window was asked for may never come: it may have been closed. */
  moveTo(document: Document): void {
    if (document === this.#document) return;
    this.window.cancelAnimationFrame(this.#request);
    this.#request = 0;
    this.#document = document;
    this.wake();
  }

  readonly #tick = (at: number): void => {
    this.#request = 0;
    const now = this.window === window ? at : performance.now(); // each window counts from its own beginning
    const seconds = Math.min(LONGEST_STEP, Math.max(0, (now - this.#last) / 1000));
    this.#last = now;
    this.tick(now, seconds);
  };
}
