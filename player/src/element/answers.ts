/** What somebody waits for: answers that come in the order of the questions, or never. */
export class Answers<T> {
  readonly #waiting: { readonly resolve: (answer: T) => void; readonly reject: (reason: Error) => void }[] = [];

  get awaited(): boolean {
    return this.#waiting.length > 0;
  }

  next(): Promise<T> {
    return new Promise((resolve, reject) => {
      this.#waiting.push({ resolve, reject });
    });
  }

  /** Answers who has waited longest. */
  answer(answer: T): void {
    this.#waiting.shift()?.resolve(answer);
  }

  /** Tells who has waited longest that there is no answer. */
  refuse(reason: Error): void {
    this.#waiting.shift()?.reject(reason);
  }

  answerAll(answer: T): void {
    for (const { resolve } of this.#waiting.splice(0)) resolve(answer);
  }

  refuseAll(reason: Error): void {
    for (const { reject } of this.#waiting.splice(0)) reject(reason);
  }
}
