"""Cameras placed from their videos: by a board that moves through the take, else by structure from motion."""
