/** What is wrong with a stream, by the reason codes of SPEC section 9. */

export const REASONS = [
  "bad-signature",
  "text-damage",
  "unsupported-version",
  "truncated",
  "bad-sync",
  "bad-header-crc",
  "bad-payload-crc",
  "reserved-bits",
  "too-large",
  "unknown-critical",
  "misplaced-packet",
  "trailing-data",
  "index-mismatch",
  "bad-header",
  "unsupported-effect",
  "unsupported-mode",
  "bad-payload",
  "bad-index-set",
  "bad-compression",
  "too-many-gaussians",
  "missing-key",
  "frame-order",
  "digest-mismatch",
] as const;

export type Reason = (typeof REASONS)[number];

/** What no reader may conceal (SPEC section 7, "Damage"): it is another format, a limit, or a header of no use. */
const NO_DAMAGE: ReadonlySet<Reason> = new Set<Reason>([
  "bad-signature",
  "text-damage",
  "unsupported-version",
  "unsupported-effect",
  "unsupported-mode",
  "unknown-critical",
  "reserved-bits",
  "bad-header",
  "too-large",
  "too-many-gaussians",
]);

/** A stream that cannot be read on. `reason` is null where the bytes themselves could not be had. */
export class StreamError extends Error {
  override readonly name = "StreamError";
  readonly reason: Reason | null;
  /** Number of the packet, counted from 0; null in the prologue, and where reading did not begin at the start. */
  packet: number | null = null;
  /** Stream offset of the packet's first byte; null where no place is known. */
  offset: number | null = null;

  constructor(reason: Reason | null, message: string) {
    super(message);
    this.reason = reason;
  }

  /** Says where it is, unless that was said before. */
  at(packet: number | null, offset: number): this {
    if (this.offset === null) {
      this.packet = packet;
      this.offset = offset;
    }
    return this;
  }

  /** One sentence for people, with reason code and place. */
  get sentence(): string {
    const location = this.offset === null ? "" : ` at byte ${this.offset}`;
    return this.reason === null ? this.message : `${this.message} (${this.reason}${location})`;
  }
}

export function refuse(reason: Reason, message: string): never {
  throw new StreamError(reason, message);
}

/** Whether bytes changed or went missing, so that the last good frame may be shown instead. */
export function isDamage(error: unknown): error is StreamError {
  return error instanceof StreamError && error.reason !== null && !NO_DAMAGE.has(error.reason);
}
