"""Ctrl-C at any moment of a command: one line, exit code 130, no traceback."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from decogs import entry

SLOW = {
    "while modules are loaded": "interrupt()\ntime.sleep(60)",
    "in code that swallows it": "try:\n    interrupt()\n    time.sleep(60)\nexcept BaseException:\n    pass",
    "before the command": "def main():\n    interrupt()\n    time.sleep(60)",
    "while the process ends": "import atexit\natexit.register(lambda: (interrupt(), time.sleep(60)))\n"
    "def main():\n    return 0",
    "while a thread is waited for": "import threading\ndef work():\n    time.sleep(.3)\n    interrupt()\n"
    "    time.sleep(60)\ndef main():\n    threading.Thread(target=work).start()\n    return 0",
}


def ended(folder: Path, module: str) -> subprocess.CompletedProcess[str]:
    """A command of that module, run as the console scripts run theirs."""
    head = "import os, signal, time\ndef interrupt():\n    os.kill(os.getpid(), signal.SIGINT)\n"
    (folder / "slow.py").write_text(f"{head}{module}\n")
    program = "import sys; from decogs.entry import _run; sys.argv[0] = '/bin/decogs-x'; sys.exit(_run('slow', 'main'))"
    return subprocess.run(
        [sys.executable, "-c", program],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=30,
        # A shell's background jobs ignore Ctrl-C and pass that on; the child is to behave as in the foreground.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


@pytest.mark.parametrize("moment", SLOW)
def test_ctrl_c_ends_a_command_in_one_line(moment: str, tmp_path: Path) -> None:
    run = ended(tmp_path, SLOW[moment])
    assert (run.returncode, run.stdout, run.stderr) == (130, "", "decogs-x: interrupted\n")


def test_ctrl_c_before_a_command_begins(tmp_path: Path) -> None:
    """From the moment at which a script has loaded this module; what comes before is Python's own."""
    program = "import sys; sys.argv[0] = '/bin/decogs-x'; from decogs import entry; import os; os.kill(os.getpid(), 2)"
    run = subprocess.run(
        [sys.executable, "-c", f"{program}; import time; time.sleep(60)"],
        capture_output=True,
        text=True,
        timeout=30,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert (run.returncode, run.stdout, run.stderr) == (130, "", "decogs-x: interrupted\n")


def test_what_ignores_ctrl_c_still_does(tmp_path: Path) -> None:
    """As a command behind nohup, or in the background of a script."""
    (tmp_path / "slow.py").write_text(
        "import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n"
        "def main():\n    os.kill(os.getpid(), signal.SIGINT)\n    return 7\n"
    )
    program = "import sys; from decogs.entry import _run; sys.exit(_run('slow', 'main'))"
    run = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=30,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),
    )
    assert (run.returncode, run.stderr) == (7, "")


def test_a_command_of_ours_that_is_interrupted_while_it_loads(tmp_path: Path) -> None:
    program = """
import sys, time
from decogs import entry
class Slow:
    def find_spec(self, name, path, target=None):
        if name == "decogs.encoder.commands":
            print("there", flush=True)
            time.sleep(60)
sys.meta_path.insert(0, Slow())
sys.exit(entry.encode())
"""
    child = subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path), "-o", "x.dgs"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert child.stdout is not None
    assert child.stdout.readline() == "there\n"
    child.send_signal(signal.SIGINT)
    _, err = child.communicate(timeout=60)
    assert (child.returncode, err) == (130, "-c: interrupted\n")


HEAVY = ("PIL", "OpenEXR", "av", "cv2", "matplotlib", "pxr", "pycolmap", "ray", "torch", "tqdm")
HEAVY += ("decogs.formats.rigs.opening", "decogs.decoder.rasterise", "decogs.encoder.frame", "decogs.encoder.keyframe")


@pytest.mark.parametrize("module", sorted(set(re.findall(r'_command\("([a-z.]+)"', Path(entry.__file__).read_text()))))
def test_a_command_begins_without_what_is_slow_to_load(module: str) -> None:
    """Help, and what is wrong with the options, come in a fraction of a second; these take longer than all the rest."""
    program = "import sys; from importlib import import_module; import_module(sys.argv[1]); print(*sys.modules)"
    run = subprocess.run(
        [sys.executable, "-c", program, f"decogs.{module}"], capture_output=True, text=True, check=True, timeout=30
    )
    assert set(HEAVY).isdisjoint(run.stdout.split())
