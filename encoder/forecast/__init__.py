"""What an encode will cost and be worth, before it is begun: from a short one of the same rig (DESIGN.md)."""
