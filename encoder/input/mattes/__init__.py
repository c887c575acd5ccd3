"""What of each picture is subject: mattes that come with a rig, clean plates, a key; and what teaches nothing."""

from .choice import MatteChoice
from .mattes import Cut, Mattes, open_mattes

__all__ = ["Cut", "MatteChoice", "Mattes", "open_mattes"]
