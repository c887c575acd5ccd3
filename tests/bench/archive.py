"""Packs a folder of full reports and their runs, which git does not keep, into one archive to publish beside a release.

``make report`` runs it: ``python tests/bench/archive.py report/full`` writes report/full.zip. Unpacked in that folder,
the runs count as made.
"""

from __future__ import annotations

import io
import sys
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

from decogs.formats.files.outputs import write_whole

KINDS = {".md", ".json", ".png", ".html"}
"""What reports and runs consist of; anything else is unfinished, or a stream."""


def main(reports: Path) -> None:
    files = sorted(path for path in reports.rglob("*") if path.suffix in KINDS)
    if not files:
        sys.exit(f"{reports}: has no reports to pack; `make report` makes them")
    packed = io.BytesIO()
    with ZipFile(packed, "w", ZIP_DEFLATED) as archive:
        for path in files:
            archive.write(path, path.relative_to(reports))
    target = reports.parent / f"{reports.name}.zip"
    write_whole(target, packed.getvalue())
    print(f"{target}: {len(files)} files, {packed.tell() / 1e6:.1f} MB")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
