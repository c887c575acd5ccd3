"""The subject of a stream alone: the hull of its mattes."""
