"""Methods to compare with, found by entry point: 3DGStream's recipe, and a method with parts left out."""
