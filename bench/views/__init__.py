"""Viewpoints where no camera stood: every camera of a rig left out in turn."""
