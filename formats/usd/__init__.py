"""OpenUSD: Gaussians over time written as prims, and a stranger's layer read."""
