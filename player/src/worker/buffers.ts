/** Buffers that go to the page and come back: a frame then allocates nothing, and memory stays flat. */

const KEPT = 8;

export class Buffers {
  private free: ArrayBuffer[] = [];

  words(length: number): Uint32Array {
    return new Uint32Array(this.take(4 * length), 0, length);
  }

  bytes(length: number): Uint8Array {
    return new Uint8Array(this.take(length), 0, length);
  }

  giveBack(buffers: readonly ArrayBuffer[]): void {
    this.free.push(...buffers.filter((buffer) => buffer.byteLength > 0));
    this.free.sort((a, b) => a.byteLength - b.byteLength);
    while (this.free.length > KEPT) this.free.shift(); // the smallest serves least
  }

  private take(length: number): ArrayBuffer {
    const at = this.free.findIndex((buffer) => buffer.byteLength >= length && buffer.byteLength <= 4 * length + 4096);
    if (at >= 0) return this.free.splice(at, 1)[0];
    return new ArrayBuffer(Math.ceil((length * 1.125) / 4096) * 4096);
  }
}
