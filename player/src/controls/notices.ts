/** The notice over the picture: what is wrong, for as long as it is, and what is said for a moment. */
const NOTICE_MS = 2600;

export class Notices {
  #warning: string | null = null;
  #timer = 0;

  constructor(private readonly notice: HTMLElement) {}

  /** Says what is wrong for as long as it is; null when nothing is. */
  warn(text: string | null): void {
    if (text === this.#warning) return;
    this.#warning = text;
    this.#show(text ?? "", text !== null);
  }

  /** Says something for a moment, also while something is wrong. */
  say(text: string): void {
    this.#show(text, false);
  }

  /** Says something for a moment, unless something is wrong. */
  hint(text: string): void {
    if (this.#warning === null) this.say(text);
  }

  /** One that does not stay goes by itself, and gives way to a warning that does. */
  #show(text: string, stays: boolean): void {
    clearTimeout(this.#timer);
    const { notice } = this;
    notice.textContent = text;
    notice.hidden = text === "";
    notice.classList.toggle("warning", stays);
    if (stays || text === "") return;
    this.#timer = window.setTimeout(() => {
      this.#show(this.#warning ?? "", this.#warning !== null);
    }, NOTICE_MS);
  }
}
