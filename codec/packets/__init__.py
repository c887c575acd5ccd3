"""The payloads of packets: key, delta and skip, corrections of cameras, sound."""
