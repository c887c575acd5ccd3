"""Opens a .dgs stream, reconstructs any frame, renders any view and exports it; never needs torch.

``decode``, ``export``, ``info`` and ``view`` do what the commands of those names do, with values for options;
``open_stream`` and
``render_view`` are the library below them. What is heavy (OpenCV, OpenEXR, OpenUSD, the rasteriser's kernel) is only
loaded when it is used.
"""

from .damage import Damage, DamageWarning
from .decoding import DecodeReport, decode
from .exporting import ExportReport, export
from .frame import DecodedFrame
from .sound.extracting import SoundReport, decode_sound
from .stream import Stream, open_stream
from .stream_info import StreamInfo, info
from .viewing.notebook import View, view
from .views import render_view

__all__ = [
    "Damage",
    "DamageWarning",
    "DecodeReport",
    "DecodedFrame",
    "ExportReport",
    "SoundReport",
    "Stream",
    "StreamInfo",
    "View",
    "decode",
    "decode_sound",
    "export",
    "info",
    "open_stream",
    "render_view",
    "view",
]
