/** What is wrong with a stream: the worst of it is said, as long as it is. */
import type { ExactAnswer } from "../messages";
import type { Drawing } from "./session_host";

export class Faults {
  /** Why nothing plays, a sentence; null when nothing is wrong, as with all that follow. */
  error: string | null = null;
  /** Why nothing comes from the network. */
  trouble: string | null = null;
  /** What is wrong with the frame in the picture. */
  damage: string | null = null;
  /** What was said of the stream last. */
  notice: string | null = null;
  /** Why WebGL2 draws where the kernel was to. */
  #instead: string | null = null;

  constructor(private readonly warn: (text: string | null) => void) {}

  say(): void {
    this.warn(this.error ?? this.trouble ?? this.damage ?? this.notice ?? this.#instead);
  }

  forget(): void {
    this.error = this.trouble = this.damage = this.notice = this.#instead = null;
  }

  /**
   * Hands the kernel's answer on. Where it gives no picture, WebGL2 draws instead, which is said; without WebGL2, nothing does: then why,
   * otherwise null.
   */
  exactlyDrawn(answer: ExactAnswer, pictures: Drawing): string | null {
    const { picture, problem, kernel } = answer;
    const { exact: wanted } = pictures; // or WebGL2 was chosen meanwhile
    pictures.exactlyDrawn(answer);
    if (picture !== null) this.#instead = null;
    if (problem === null || !wanted) return null;
    if (!pictures.exact) this.#instead = `WebGL2 draws: ${problem}`;
    else if (kernel && !pictures.awaitsKernel) this.notice = problem;
    else return problem;
    return null;
  }
}
