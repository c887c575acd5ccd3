"""Coverage-guided fuzzing of one target, in a process of its own that libFuzzer ends: needs atheris.

python guided.py TARGET RUNS SEED FOLDER: begins with the target's seeds, leaves what it learnt in FOLDER/corpus, an
input that misbehaves as FOLDER/crash-..., and the figures so far in FOLDER/figures.json.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import atheris

sys.path.insert(0, str(Path(__file__).parent))
with atheris.instrument_imports(include=["decogs.formats", "decogs.codec"]):
    import hostile

_REPORT_EVERY = 100


def main() -> None:
    name, runs, seed, folder = sys.argv[1], int(sys.argv[2]), sys.argv[3], Path(sys.argv[4])
    corpus = folder / "corpus"
    corpus.mkdir(parents=True)
    target, seeds = hostile.parsers()[name]
    for number, data in enumerate(seeds):
        (corpus / f"seed-{number}").write_bytes(data)
        target(data)
    judge = hostile.Judge(target)

    def try_one(data: bytes) -> None:
        judge.try_one(data)
        if judge.tried % _REPORT_EVERY == 0:
            (folder / "figures.json").write_text(json.dumps(judge.figures()))

    # libFuzzer's own clock counts what other programs take: the judge's is the one that decides.
    options = [f"-runs={runs}", f"-seed={seed}", "-max_len=4096", "-timeout=60", "-rss_limit_mb=0", "-verbosity=0"]
    atheris.Setup([sys.argv[0], *options, f"-artifact_prefix={folder}/", str(corpus)], try_one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
