import { refuse } from "./errors";

/** The fields of a payload, read from its first byte to its last; none may reach beyond its end (SPEC section 6). */
export class Fields {
  private readonly view: DataView;
  private position = 0;

  constructor(private readonly bytes: Uint8Array) {
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  }

  u8(): number {
    return this.view.getUint8(this.advance(1));
  }

  i16(): number {
    return this.view.getInt16(this.advance(2), true);
  }

  u32(): number {
    return this.view.getUint32(this.advance(4), true);
  }

  i32(): number {
    return this.view.getInt32(this.advance(4), true);
  }

  u64(): bigint {
    return this.view.getBigUint64(this.advance(8), true);
  }

  /** The next bytes, not copied. */
  take(length: number): Uint8Array {
    const start = this.advance(length);
    return this.bytes.subarray(start, start + length);
  }

  get rest(): number {
    return this.bytes.length - this.position;
  }

  finish(): void {
    if (this.rest > 0) refuse("bad-payload", `${this.rest} bytes are left over in the payload`);
  }

  private advance(length: number): number {
    if (length > this.rest) refuse("bad-payload", "a field reaches beyond the payload's end");
    const start = this.position;
    this.position += length;
    return start;
  }
}
