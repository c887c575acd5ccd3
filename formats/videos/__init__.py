"""Videos: their frames by time of presentation, clean aperture, chapters and timecode."""
