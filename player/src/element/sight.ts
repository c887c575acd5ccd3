/** Whether an element can be seen: its page is shown, and it lies within the window. */
export class Sight {
  /** Scrolled out of the window, or not shown at all. */
  offScreen = false;
  #document = document;
  #observer: IntersectionObserver | null = null;

  constructor(private readonly changed: () => void) {}

  /** Whether the whole page is hidden: another tab is in front. */
  get pageHidden(): boolean {
    return this.#document.hidden;
  }

  /** Whether nobody sees the element; one that is `heard` plays on out of the window, but not in a page that is hidden. */
  isUnseen(heard: boolean): boolean {
    return this.pageHidden || (this.offScreen && !heard);
  }

  begin(element: HTMLElement): void {
    this.end();
    this.#document = element.ownerDocument;
    this.#document.addEventListener("visibilitychange", this.changed);
    // That of the element's own window, where it may be in one of its own.
    const { IntersectionObserver } = this.#document.defaultView ?? window;
    this.#observer = new IntersectionObserver((entries) => {
      this.offScreen = entries.at(-1)?.isIntersecting === false;
      this.changed();
    });
    this.#observer.observe(element);
  }

  end(): void {
    this.#document.removeEventListener("visibilitychange", this.changed);
    this.#observer?.disconnect();
    this.#observer = null;
    this.offScreen = false;
  }
}
