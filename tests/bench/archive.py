"""Packs every report's runs, which git does not keep, into one archive to publish beside a release.

``make report`` runs it: ``python tests/bench/archive.py report``. Unpacked in that folder, the runs count as made.
"""

from __future__ import annotations

import io
import sys
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

from decogs.formats.outputs import write_whole


def main(report: Path) -> None:
    runs = sorted(path for path in report.rglob("runs/*") if path.suffix in {".json", ".png"})
    if not runs:
        sys.exit(f"{report}: has no runs to pack; `make report` makes them")
    packed = io.BytesIO()
    with ZipFile(packed, "w", ZIP_DEFLATED) as archive:
        for path in runs:
            archive.write(path, path.relative_to(report))
    write_whole(report / "runs.zip", packed.getvalue())
    print(f"{report / 'runs.zip'}: {len(runs)} files, {packed.tell() / 1e6:.1f} MB")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
