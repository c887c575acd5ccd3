/** Tells when the GPU has finished a picture, without waiting for it. */

const POLL_MS = 2;

export class GpuClock {
  private fence: WebGLSync | null = null;
  private timer = 0;

  constructor(private readonly gl: WebGL2RenderingContext) {}

  get busy(): boolean {
    return this.fence !== null;
  }

  /** Calls back with the milliseconds from now until all commands given so far are done. */
  start(done: (milliseconds: number) => void): void {
    this.stop();
    const { gl } = this;
    const begun = performance.now();
    this.fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    const poll = (): void => {
      if (this.fence === null) return;
      const state = gl.clientWaitSync(this.fence, 0, 0);
      if (state === gl.TIMEOUT_EXPIRED) {
        this.timer = window.setTimeout(poll, POLL_MS);
        return;
      }
      this.stop();
      if (state !== gl.WAIT_FAILED) done(performance.now() - begun);
    };
    this.timer = window.setTimeout(poll, 0);
  }

  stop(): void {
    clearTimeout(this.timer);
    if (this.fence !== null) this.gl.deleteSync(this.fence);
    this.fence = null;
  }
}
