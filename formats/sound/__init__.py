"""Sound of videos and of files: tracks on the clock of the pictures, and Opus."""
