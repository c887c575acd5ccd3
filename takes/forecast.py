"""What the encode of a take will cost and be worth, before it is begun: `decogs-analyze --forecast` of its rig."""

from __future__ import annotations

from .child import run_command
from .options import has_option
from .take_file import Take

_COMMAND = "decogs-analyze"
_HEADING = "forecast of "


def forecast(take: Take, *, shown: bool) -> list[str]:
    """Lines for the user, the command first; ``shown``: its progress goes to stderr."""
    step = next(step for step in take.steps if step.command == "decogs-encode")
    rig = step.inputs[0]
    if not (take.folder / rig).exists():
        return [f"no forecast: {rig} is made first"]
    words = [word for word in step.words if has_option(_COMMAND, word.partition("=")[0])]
    line = [_COMMAND, rig, "--forecast", *words]
    ran = run_command([*line, *([] if shown else ["-q"])], take.folder, shown=shown)
    if ran.code:
        return [f"$ {' '.join(line)}", f"no forecast: {ran.said or f'{_COMMAND} ended with code {ran.code}'}"]
    printed = ran.printed.splitlines()
    begins = next(at for at, text in enumerate(printed) if text.startswith(_HEADING))
    return [f"$ {' '.join(line)}", *printed[begins:]]
