/** Pauses of work that takes long, so that messages come in and it can be aborted. */
const BUSY_MS = 20;

export class Pauses {
  private busySince = performance.now();

  /** Work begins, behind something else that has waited. */
  begin(): void {
    this.busySince = performance.now();
  }

  /** A pause, if it is time for one. */
  async take(): Promise<void> {
    if (performance.now() - this.busySince < BUSY_MS) return;
    await new Promise((resolve) => setTimeout(resolve));
    this.begin();
  }
}
