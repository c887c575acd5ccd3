"""``tests/encoder/conftest.py`` as a module: pytest shares its fixtures with the tests beside it only."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

_FOUND = importlib.util.spec_from_file_location("encoder_conftest", Path(__file__).parent / "encoder" / "conftest.py")
assert _FOUND is not None
assert _FOUND.loader is not None
encoder_conftest = importlib.util.module_from_spec(_FOUND)
sys.modules["encoder_conftest"] = encoder_conftest
_FOUND.loader.exec_module(encoder_conftest)
