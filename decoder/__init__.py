"""Opens a .dgs stream, reconstructs any frame, renders any view and exports it; never needs torch."""
