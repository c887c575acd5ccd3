"""Sound of a stream: its SOUND packets found, heard, and made (SPEC.md, "Sound packet")."""
