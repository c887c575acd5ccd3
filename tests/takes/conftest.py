"""Fixtures of tests of takes."""

from __future__ import annotations

import tiny_rigs

tiny_rig, moving_rig = tiny_rigs.tiny_rig, tiny_rigs.moving_rig
