/** What the worker is asked for and answers once; when it is gone, whoever waits is told. */
import type { PinholeCamera } from "../geometry/camera";
import type { ExactPicture, FromWorker, ToWorker } from "../messages";
import { Answers } from "./answers";

export class Questions {
  readonly #stills = new Answers<ExactPicture | null>();
  readonly #plys = new Answers<Uint8Array<ArrayBuffer>>();
  #worker = new AbortController();

  constructor(private readonly send: (message: ToWorker) => void) {
    this.lose(new Error("no stream is open"));
  }

  /** Aborted where nobody answers any more: no stream is open, or its worker has died. */
  get lost(): AbortSignal {
    return this.#worker.signal;
  }

  /** There is a worker that answers. */
  begin(): void {
    this.#worker = new AbortController();
  }

  /** The worker is gone: nothing that it was asked for comes. */
  lose(reason: Error): void {
    this.#worker.abort(reason);
    this.#stills.refuseAll(reason);
    this.#plys.refuseAll(reason);
  }

  still(frame: number, camera: PinholeCamera): Promise<ExactPicture | null> {
    return this.#ask(this.#stills, { type: "still", frame, camera });
  }

  ply(): Promise<Uint8Array<ArrayBuffer>> {
    return this.#ask(this.#plys, { type: "ply" });
  }

  receive(message: Extract<FromWorker, { type: "still" | "ply" }>): void {
    if (message.type === "still") this.#stills.answer(message.picture);
    else if (message.bytes === null) this.#plys.refuse(new Error(message.problem));
    else this.#plys.answer(message.bytes);
  }

  #ask<T>(answers: Answers<T>, question: ToWorker): Promise<T> {
    if (this.lost.aborted) return Promise.reject(this.lost.reason as Error);
    this.send(question);
    return answers.next();
  }
}
