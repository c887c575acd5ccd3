"""The header packet, and how a stream wants to be shown."""
