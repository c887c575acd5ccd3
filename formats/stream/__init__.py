"""The .dgs container: packets, where they lie, and why one is refused (SPEC.md)."""
