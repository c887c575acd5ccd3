/** Callbacks of pages that want to know which frame has come into the picture, as those of <video>. */
export class FrameCallbacks {
  readonly #asked = new Map<number, VideoFrameRequestCallback>();
  #requests = 0;
  /** The frame that was in the picture last; -1: none of this stream. */
  #presented = -1;
  #count = 0;

  request(callback: VideoFrameRequestCallback): number {
    this.#asked.set(++this.#requests, callback);
    return this.#requests;
  }

  cancel(request: number): void {
    this.#asked.delete(request);
  }

  /** Another stream is opened. */
  begin(): void {
    this.#presented = -1;
    this.#count = 0;
  }

  /** What was sought is drawn next, and counts, though it be the same frame. */
  sought(): void {
    this.#presented = -1;
  }

  /** A picture was drawn, which shows this frame. What a callback asks for is of the next frame. */
  drawn(frame: number, now: number, { width, height, fps, costMs }: { readonly width: number; readonly height: number; readonly fps: number; readonly costMs: number }): void {
    if (frame === this.#presented) return;
    this.#presented = frame;
    const metadata = { presentationTime: now, expectedDisplayTime: now, width, height, mediaTime: frame / fps, presentedFrames: ++this.#count, processingDuration: costMs / 1000 };
    for (const request of [...this.#asked.keys()]) {
      const callback = this.#asked.get(request);
      this.#asked.delete(request);
      try {
        callback?.(now, metadata);
      } catch (error) {
        reportError(error);
      }
    }
  }
}
