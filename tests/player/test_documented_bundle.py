"""The bundle of frame_source.ts, made as player/README.md tells, loads in a Node without the newest functions."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path

from node import PLAYER, node

PAGE = PLAYER / "README.md"


def test_the_documented_command_makes_a_module_that_loads(tmp_path: Path) -> None:
    program = node()
    (command,) = re.findall(r"`npx (esbuild src/export/frame_source\.ts .*?)`", PAGE.read_text())
    words = [word for word in shlex.split(command) if not word.startswith("--outfile=")]
    made = tmp_path / "frames.mjs"
    words[0] = str(PLAYER / "node_modules" / ".bin" / "esbuild")
    subprocess.run([*words, f"--outfile={made}"], cwd=PLAYER, check=True, capture_output=True)
    # Browsers and Node 20 have no Uint8Array.fromBase64; newer ones have: it is taken away.
    loads = f"delete Uint8Array.fromBase64; console.log(typeof (await import({str(made)!r})).createFrameSource)"
    run = subprocess.run(
        [program, "--input-type=module", "-e", loads], capture_output=True, text=True, check=False, timeout=60
    )
    assert run.stdout == "function\n", run.stderr
