"""How things look on disk and on the wire: scene vocabulary, rig readers, pictures, the container, exchange formats."""
