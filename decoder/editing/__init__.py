"""Edits of a stream, without training: ``edit`` with the operations below, in the order given.

``read_recipe`` reads operations from a file, as ``decogs-edit --recipe`` does.
"""

from .editing import EditReport, edit
from .operations.base import Operation
from .operations.trim import Trim
from .recipe import read_recipe

__all__ = ["EditReport", "Operation", "Trim", "edit", "read_recipe"]
