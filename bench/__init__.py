"""The bench: variants of the encoder and rivals run over rigs, measured on held-out cameras, written up as a report."""
