"""Opens a .dgs stream, reconstructs any frame, renders any view and exports it; never needs torch.

``decode``, ``export``, ``info`` and ``view`` do what the commands of those names do, with values for options;
``open_stream`` and
``render_view`` are the library below them. What is heavy (OpenCV, OpenEXR, OpenUSD, the rasteriser's kernel) is only
loaded when it is used.
"""

from typing import TYPE_CHECKING

from decogs.formats.lazy_names import lazy_names

if TYPE_CHECKING:
    from .damage import Damage as Damage
    from .damage import DamageWarning as DamageWarning
    from .decoding import DecodeReport as DecodeReport
    from .decoding import decode as decode
    from .exporting import ExportReport as ExportReport
    from .exporting import export as export
    from .frame import DecodedFrame as DecodedFrame
    from .sound.extracting import SoundReport as SoundReport
    from .sound.extracting import decode_sound as decode_sound
    from .stream import Stream as Stream
    from .stream import open_stream as open_stream
    from .stream_info import StreamInfo as StreamInfo
    from .stream_info import info as info
    from .viewing.notebook import View as View
    from .viewing.notebook import view as view
    from .views import render_view as render_view

_HOMES = {
    "Damage": "damage",
    "DamageWarning": "damage",
    "DecodeReport": "decoding",
    "decode": "decoding",
    "ExportReport": "exporting",
    "export": "exporting",
    "DecodedFrame": "frame",
    "SoundReport": "sound.extracting",
    "decode_sound": "sound.extracting",
    "Stream": "stream",
    "open_stream": "stream",
    "StreamInfo": "stream_info",
    "info": "stream_info",
    "View": "viewing.notebook",
    "view": "viewing.notebook",
    "render_view": "views",
}
__all__ = list(_HOMES)
__getattr__ = lazy_names(__name__, _HOMES)
