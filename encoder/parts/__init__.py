"""Parts: a stream of closed segments, encoded in pieces that know nothing of each other, and joined again.

A part is a stream by itself: the header, with a manifest in its settings, the first keyframe as it was written once,
then its own frames, counted on from there. Any player shows it. `decogs-join` puts the frames under their own numbers;
the payloads stay as they are, so joined parts have the bytes of an encode in one go.

Chosen: the manifest in the header's settings, which are for people and tools (SPEC.md, section 4). Rejected: a file
beside each part (it can be lost, or that of another part), a packet kind of its own (a part needs no new format).
"""
