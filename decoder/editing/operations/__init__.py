"""The operations of ``decogs-edit``, a file each.

A new one is a file with a subclass of ``Operation``, and a line here.
"""

from __future__ import annotations

from .base import Operation
from .trim import Trim

OPERATIONS: dict[str, type[Operation]] = {operation.name: operation for operation in (Trim,)}
"""By name, in the order in which they are listed."""
