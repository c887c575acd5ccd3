"""Hypothesis without deadlines: they would measure the machine and what else it does, not the code."""

from __future__ import annotations

import contextlib

with contextlib.suppress(ImportError):  # the wheel is checked in an environment without it
    import hypothesis

    hypothesis.settings.register_profile("decogs", deadline=None)
    hypothesis.settings.load_profile("decogs")
