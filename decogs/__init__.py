"""decogs: free-viewpoint video as streamed 3D Gaussians.

In a checkout the folder has a link for every layer, so that it is the package as it gets installed.
"""

__version__: str


def __getattr__(name: str) -> str:
    """``__version__``, of the installed package. Loading ``importlib.metadata`` takes longer than all of this."""
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib.metadata import version

    return version("decogs")
