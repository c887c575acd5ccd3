/** What a session needs of the player that shows its stream. */
import type { DrawOrder, ExactAnswer, SceneUpdate, TextureLayout } from "../messages";
import type { StreamHeader } from "../scene";
import type { PlayerEvent } from "./events";

/** What draws a stream: the element's pictures, or a scene of somebody else's. */
export interface Drawing {
  begin(layout: TextureLayout, header: StreamHeader): void;
  exactlyDrawn(answer: ExactAnswer): void;
  /** Whether the kernel draws, and has not drawn anything yet. */
  readonly awaitsKernel: boolean;
  /** Whether the kernel is the one that draws. */
  readonly exact: boolean;
  readonly stage: {
    begin(): void;
    load(update: SceneUpdate | null, draw: DrawOrder): void;
    order(draw: DrawOrder): void;
  };
}

export interface SessionHost {
  readonly tell: (name: PlayerEvent) => void;
  readonly wake: () => void;
  readonly loading: (on: boolean) => void;
  /** People are to see that something is waited for, and how much of it is there, from 0 to 1, where that is known. */
  readonly busy: (on: boolean, share: number | null) => void;
  /** Opens the stream anew. */
  readonly reopen: () => void;
  /** Says the worst of what is wrong, as long as it is. */
  readonly warn: (text: string | null) => void;
  /** The stream's header has come: cameras can be put up. */
  readonly opened: (header: StreamHeader) => void;
  readonly autoplay: () => boolean;
}
