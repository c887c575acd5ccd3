"""The stable reason codes a StreamError carries (SPEC.md, section "Reason codes")."""

from __future__ import annotations

from typing import Final


class Reason:
    """One constant per code; the text after the equals sign is what users and tests see."""

    BAD_SIGNATURE: Final = "bad-signature"
    TEXT_DAMAGE: Final = "text-damage"
    UNSUPPORTED_VERSION: Final = "unsupported-version"
    TRUNCATED: Final = "truncated"
    BAD_SYNC: Final = "bad-sync"
    BAD_HEADER_CRC: Final = "bad-header-crc"
    BAD_PAYLOAD_CRC: Final = "bad-payload-crc"
    RESERVED_BITS: Final = "reserved-bits"
    TOO_LARGE: Final = "too-large"
    UNKNOWN_CRITICAL: Final = "unknown-critical"
    MISPLACED_PACKET: Final = "misplaced-packet"
    TRAILING_DATA: Final = "trailing-data"
    INDEX_MISMATCH: Final = "index-mismatch"
    BAD_HEADER: Final = "bad-header"
    UNSUPPORTED_EFFECT: Final = "unsupported-effect"
    UNSUPPORTED_MODE: Final = "unsupported-mode"
    BAD_PAYLOAD: Final = "bad-payload"
    BAD_INDEX_SET: Final = "bad-index-set"
    BAD_COMPRESSION: Final = "bad-compression"
    TOO_MANY_GAUSSIANS: Final = "too-many-gaussians"
    MISSING_KEY: Final = "missing-key"
    FRAME_ORDER: Final = "frame-order"
    DIGEST_MISMATCH: Final = "digest-mismatch"


ALL_REASONS: Final = frozenset(value for name, value in vars(Reason).items() if name.isupper())

DAMAGE: Final = frozenset(
    {
        Reason.TRUNCATED,
        Reason.BAD_SYNC,
        Reason.BAD_HEADER_CRC,
        Reason.BAD_PAYLOAD_CRC,
        Reason.MISPLACED_PACKET,
        Reason.TRAILING_DATA,
        Reason.INDEX_MISMATCH,
        Reason.BAD_PAYLOAD,
        Reason.BAD_INDEX_SET,
        Reason.BAD_COMPRESSION,
        Reason.MISSING_KEY,
        Reason.FRAME_ORDER,
        Reason.DIGEST_MISMATCH,
    }
)
"""What a reader may conceal: bytes that changed or went missing. The others say that the reader cannot or must not show
the stream: another format or version, or a limit."""
