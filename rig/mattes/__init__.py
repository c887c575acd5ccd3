"""What of each picture is subject: mattes that come with a rig, clean plates, a key; and what teaches nothing."""

from typing import TYPE_CHECKING

from decogs.formats.system.lazy_names import lazy_names

if TYPE_CHECKING:
    from .choice import MatteChoice as MatteChoice
    from .mattes import Cut as Cut
    from .mattes import Mattes as Mattes
    from .mattes import files_of_mattes as files_of_mattes
    from .mattes import open_mattes as open_mattes

_HOMES = {
    "MatteChoice": "choice",
    "Cut": "mattes",
    "Mattes": "mattes",
    "files_of_mattes": "mattes",
    "open_mattes": "mattes",
}
__all__ = list(_HOMES)
__getattr__ = lazy_names(__name__, _HOMES)
