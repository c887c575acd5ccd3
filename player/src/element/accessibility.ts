/** The player for screen readers and keyboards, as far as the page's author has said nothing else. */

/** Until a stream has told its title. */
const UNNAMED = "Free-viewpoint video";

export class Accessibility {
  /** The name that the page's author has not given. */
  #ownName = "";

  constructor(private readonly element: HTMLElement) {}

  begin(): void {
    const { element } = this;
    if (!element.hasAttribute("tabindex")) element.tabIndex = 0;
    if (!element.hasAttribute("role")) element.setAttribute("role", "region");
    if (!element.hasAttribute("aria-label")) this.#name(UNNAMED);
  }

  /** Empty: the stream has no title. */
  setTitle(title: string): void {
    if (this.element.getAttribute("aria-label") === this.#ownName) this.#name(title || UNNAMED);
  }

  #name(text: string): void {
    this.#ownName = text;
    this.element.setAttribute("aria-label", text);
  }
}
