/** Spans of time, as <video> has them (TimeRanges). */
import type { Span } from "../player_api";

export class Ranges {
  readonly #spans: readonly Span[];

  constructor(spans: readonly Span[]) {
    this.#spans = spans;
  }

  get length(): number {
    return this.#spans.length;
  }

  start(index: number): number {
    return this.#span(index)[0];
  }

  end(index: number): number {
    return this.#span(index)[1];
  }

  #span(index: number): Span {
    const span = this.#spans.at(index);
    if (span === undefined || index < 0) throw new DOMException(`there is no range ${index}`, "IndexSizeError");
    return span;
  }
}
