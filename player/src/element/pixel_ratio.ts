/** Tells when a window has other pixels: another zoom, or another screen. Sizes in CSS pixels need not change with it. */
export class PixelRatio {
  #query: MediaQueryList | null = null;
  #window: Window = window;

  constructor(private readonly changed: () => void) {}

  get value(): number {
    return this.#window.devicePixelRatio || 1;
  }

  begin(window: Window): void {
    this.end();
    this.#window = window;
    this.#query = window.matchMedia(`(resolution: ${this.value}dppx)`);
    this.#query.addEventListener("change", this.#listen);
  }

  end(): void {
    this.#query?.removeEventListener("change", this.#listen);
    this.#query = null;
  }

  readonly #listen = (): void => {
    this.begin(this.#window);
    this.changed();
  };
}
