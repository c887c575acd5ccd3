"""A scene as a decoder has it: integers on the lattice, in Morton order, with a digest."""
