"""Blender add-on: File > Import > decogs (.dgs), File > Export > decogs camera (.json), colours of our USD exports.

Runs in Blender 4.2 and later. `build.py` packs it with the reader of this repository; `docs/blender.md` is for users.
Nothing of decogs is imported before a stream is opened: where that would fail the add-on can be enabled, and say why.
"""

from __future__ import annotations

from . import export_camera, import_stream, timeline, usd_colours


def register() -> None:
    """Menu entries, properties of objects, and the handlers that follow the timeline."""
    timeline.register()
    import_stream.register()
    export_camera.register()
    usd_colours.register()


def unregister() -> None:
    """Takes back what ``register`` did."""
    usd_colours.unregister()
    export_camera.unregister()
    import_stream.unregister()
    timeline.unregister()
