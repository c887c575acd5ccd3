"""Opens a .dgs stream, reconstructs any frame, renders any view and exports it; never needs torch.

``decode``, ``export``, ``info`` and ``view`` do what the commands of those names do, with values for options;
``open_stream`` and
``render_view`` are the library below them. What is heavy (OpenCV, OpenEXR, OpenUSD, the rasteriser's kernel) is only
loaded when it is used.
"""

from typing import TYPE_CHECKING

from decogs.formats.system.lazy_names import lazy_names

if TYPE_CHECKING:
    from .decoding import DecodeReport as DecodeReport
    from .decoding import decode as decode
    from .exporting.exporting import ExportReport as ExportReport
    from .exporting.exporting import export as export
    from .exporting.sound import SoundReport as SoundReport
    from .exporting.sound import decode_sound as decode_sound
    from .reading.damage import Damage as Damage
    from .reading.damage import DamageWarning as DamageWarning
    from .reading.frame import DecodedFrame as DecodedFrame
    from .reading.info import StreamInfo as StreamInfo
    from .reading.info import info as info
    from .reading.stream import Stream as Stream
    from .reading.stream import open_stream as open_stream
    from .rendering.views import render_view as render_view
    from .viewing.notebook import View as View
    from .viewing.notebook import view as view

_HOMES = {
    "Damage": "reading.damage",
    "DamageWarning": "reading.damage",
    "DecodeReport": "decoding",
    "decode": "decoding",
    "ExportReport": "exporting.exporting",
    "export": "exporting.exporting",
    "DecodedFrame": "reading.frame",
    "SoundReport": "exporting.sound",
    "decode_sound": "exporting.sound",
    "Stream": "reading.stream",
    "open_stream": "reading.stream",
    "StreamInfo": "reading.info",
    "info": "reading.info",
    "View": "viewing.notebook",
    "view": "viewing.notebook",
    "render_view": "rendering.views",
}
__all__ = list(_HOMES)
__getattr__ = lazy_names(__name__, _HOMES)
