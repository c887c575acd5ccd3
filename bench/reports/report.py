"""Runs what a report asks of its rigs, and writes it: Markdown with pictures, and the same figures as JSON.

Everything lies in one folder and refers to itself by relative links: NAME.md, NAME.json, pictures/ (.png and .pdf),
tables/ (.csv and .tex), runs/.
Runs are made rig by rig and kept as they come; writing takes a second, so that it is always done from what is there.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, replace
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import Any, TextIO

from decogs.formats.errors import TrainingError, UsageError
from decogs.formats.files.outputs import Output, check_folder_name, check_outputs, write_whole
from decogs.formats.rigs import files_of
from decogs.formats.system.callbacks import OnWarning

from ..machine import code_version, machine_facts
from ..questions import choices, curve, effects, paper, rates
from ..questions.variants import Question, Variant
from ..rivals.sequences import Rival
from ..runs.progress import BenchProgress
from ..runs.results import RigResults
from ..runs.rig_bench import RigBench
from ..runs.rigs import check_names
from ..runs.rivals import find_rival, point_of, point_of_rival, rival_file, run_rival
from ..runs.run import KEYFRAME, BenchOptions, Run
from ..tables import differences
from ..tables.bd_rates import bd_rates
from ..tables.columns import NOT_RUN, figures
from . import summaries
from .page import report_page
from .plans import Contest, Plan
from .plots import require_plots
from .tables import write_tables

NONE = "none"
"""For ``only``: nothing is run, the report is written from what is there."""

PAPER = Plan(
    "paper",
    "DecoGS and its baseline, measured",
    paper.QUESTIONS,
    paper.FIGURES,
    summary=summaries.summarise_gains,
)
CHOICES = Plan(
    "choices",
    "Choices, measured",
    choices.QUESTIONS,
    summary=partial(summaries.summarise_differences, choices.QUESTIONS),
)
RATES = Plan(
    "rates",
    "Rate and distortion, measured",
    rates.QUESTIONS,
    rates.FIGURES,
    Contest(rates.RIVALS_PART, rates.RATE_POINTS, rates.RIVALS),
)
EFFECTS = Plan("effects", "Effects, measured", effects.QUESTIONS, summary=summaries.summarise_effects)
CURVE = Plan(
    "curve",
    "What accuracy costs in time, measured",
    curve.QUESTIONS,
    front=True,
)
PLANS = {plan.name: plan for plan in (PAPER, CHOICES, RATES, EFFECTS, CURVE)}


def make_report(
    plan: Plan,
    rig_dirs: Sequence[str | os.PathLike[str]],
    output: str | os.PathLike[str],
    options: BenchOptions | None = None,
    *,
    only: Sequence[str] = (),
    command: str = "",
    terminal: TextIO | None = None,
    on_warning: OnWarning | None = None,
) -> Path:
    """Runs what is missing of ``plan`` on every rig, writes the report into the folder ``output``, returns its file.

    ``only``: keys of questions and figures to run for (all when empty, nothing for "none"); the others are written from
    earlier results. A variant that cannot be trained is said in the report; everything else raises DecogsError.
    """
    folder, options = Path(output), options or BenchOptions()
    wanted = _wanted(plan, only)
    if plan.figures or plan.front:
        require_plots()
    check_folder_name(folder)
    results = [RigResults(RigBench(rig_dir, folder, options)) for rig_dir in rig_dirs]
    check_names([result.bench.rig for result in results])
    written = [Output("output", folder / f"{plan.name}{suffix}", grows=True) for suffix in (".md", ".json")]
    check_outputs(written, [file for result in results for file in files_of(result.bench.rig)])
    folder.mkdir(parents=True, exist_ok=True)
    _run_missing(results, wanted, plan, terminal, on_warning)
    if plan.contest is not None:
        if not only or plan.contest.key in only:
            _run_rivals(results, plan.contest, terminal, on_warning)
        for result in results:
            _gather_rivals(result, plan.contest)
    for result in results:
        _gather(result, [*(v for question in plan.questions for v in question.variants), KEYFRAME])
        result.bench.tidy(plan.lent)
    lines = report_page(plan, results, folder, command)
    path = folder / f"{plan.name}.md"
    document = json.dumps(_document(plan, results, command), indent=1) + "\n"
    write_whole(folder / f"{plan.name}.json", document.encode())
    write_whole(path, ("\n".join(lines) + "\n").encode())
    write_tables(lines, folder / "tables", plan.name)
    return path


def _wanted(plan: Plan, only: Sequence[str]) -> list[Variant]:
    """The variants to run, in the order of their first question."""
    sets = {question.key: question.variants for question in plan.questions} | dict(plan.figures)
    if plan.contest is not None:
        sets[plan.contest.key] = (plan.contest.source,)
    for key in only:
        if key != NONE and key not in sets:
            raise UsageError(f"`only` {key}: there is no such part; choose from {', '.join(sets)}, {NONE}")
    chosen = [variants for key, variants in sets.items() if not only or key in only]
    return [variant for variants in chosen for variant in variants]


def _run_missing(
    results: Sequence[RigResults],
    wanted: Sequence[Variant],
    plan: Plan,
    terminal: TextIO | None,
    on_warning: OnWarning | None,
) -> None:
    missing = [(result, _missing(result.bench, wanted)) for result in results]
    frames = sum(len(result.bench.frames_of(variant)) for result, variants in missing for variant in variants)
    with BenchProgress(frames, terminal) as progress:
        for result, variants in missing:
            for variant in variants:
                progress.started(result.bench.name, f"{variant.name}, seed {variant.seed}")
                try:
                    run = result.bench.run(
                        variant,
                        on_frame=progress.frame,
                        on_keyframe_step=progress.keyframe_step,
                        keep_stream=replace(variant, seed=None) in plan.lent,
                    )
                except TrainingError as error:
                    earlier = result.failures.get(variant.name)
                    reason = f"seed {variant.seed}: {error}"
                    result.failures[variant.name] = reason if earlier is None else f"{earlier}; {reason}"
                    if on_warning:
                        on_warning(f"{result.bench.name} {variant.name}, {reason}")
                else:
                    progress.finished(run)


def _run_rivals(
    results: Sequence[RigResults], contest: Contest, terminal: TextIO | None, on_warning: OnWarning | None
) -> None:
    """Those of which no result is there and that can be tried here; a source that cannot be trained has none."""
    here = [rival for rival in contest.rivals if rival.coder.missing() is None]
    missing = [
        (result, [rival for rival in here if find_rival(result.bench, contest.source, rival) is None])
        for result in results
        if result.bench.find(contest.source) is not None
    ]
    frames = sum(len(result.bench.frames_of(contest.source)) * len(rivals) for result, rivals in missing)
    with BenchProgress(frames, terminal) as progress:
        for result, rivals in missing:
            bench = result.bench
            for rival in rivals:
                progress.started(bench.name, rival.name)
                stream = bench.stream(contest.source, progress.keyframe_step)
                try:
                    run_rival(bench, contest.source, rival, stream, progress.frame)
                except UsageError as error:
                    result.failures[rival.name] = str(error)
                    if on_warning:
                        on_warning(f"{bench.name} {rival.name}: {error}")


def _gather_rivals(result: RigResults, contest: Contest) -> None:
    for rival in contest.rivals:
        run = find_rival(result.bench, contest.source, rival)
        if run is not None:
            result.rivals[rival.name] = run


def _missing(bench: RigBench, wanted: Sequence[Variant]) -> list[Variant]:
    """Those of which no result is there, seed by seed, each run once, whatever its names."""
    first: dict[str, Variant] = {}
    for variant in bench.seeded(wanted):
        first.setdefault(bench.key(variant), variant)
    return [variant for variant in first.values() if bench.find(variant) is None]


def _gather(result: RigResults, variants: Sequence[Variant]) -> None:
    for variant in result.bench.seeded(variants):
        run = result.bench.find(variant)
        if run is not None:
            result.runs[run.key] = run


def _document(plan: Plan, results: Sequence[RigResults], command: str) -> dict[str, Any]:
    """The report as data: figures as numbers, rows by question; runs/ has them frame by frame."""
    return {
        "report": plan.name,
        "command": command,
        "written": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "code": code_version(),
        "machine": machine_facts(),
        "rigs": {result.bench.name: _rig_document(plan, result) for result in results},
    }


def _rig_document(plan: Plan, result: RigResults) -> dict[str, Any]:
    bench, regions = result.bench, result.bench.regions
    document: dict[str, Any] = {
        "held_out": ",".join(bench.cameras),
        "frames": [bench.frames.start, bench.frames.stop],
        "seeds": list(bench.options.seeds),
        "masks": regions.about,
        "static_share": float(regions.static.mean()),
        "dynamic_share": float(regions.dynamic.mean()),
        "failures": result.failures,
        "questions": {question.key: _rows_document(result, question) for question in plan.questions},
    }
    if plan.contest is not None:
        document[plan.contest.key] = [
            *(_rate_document(variant, run) for variant in plan.contest.rates if (run := result.run_of(variant))),
            *(_rival_document(result, plan.contest, rival) for rival in plan.contest.rivals),
        ]
        points = result.rate_points({variant.description: variant for variant in plan.contest.rates})
        document["bd_rate_anchor"] = plan.contest.anchor
        document["bd_rates"] = [row.document() for row in bd_rates(points, plan.contest.anchor)]
    return document


def _rows_document(result: RigResults, question: Question) -> list[dict[str, Any]]:
    compared = {each.variant.name: each.document() for each in differences.differences(result, question)}
    return [_row_document(result, variant, compared.get(variant.name)) for variant in question.variants]


def _row_document(result: RigResults, variant: Variant, compared: dict[str, Any] | None) -> dict[str, Any]:
    runs = result.runs_of(variant)
    row: dict[str, Any] = {"variant": variant.name, "description": variant.description}
    if runs:
        row["runs"] = {seed: f"runs/{result.bench.file_of(run).name}" for seed, run in runs.items()}
        row |= {"how": next(iter(runs.values())).command, "figures": figures(list(runs.values()))}
    return row if compared is None else row | {"differences": compared}


def _rate_document(variant: Variant, run: Run) -> dict[str, Any]:
    """A stream among its rivals."""
    label = f"decogs, {variant.description}"
    return {"variant": variant.name, "description": label, "figures": asdict(point_of(run, label))}


def _rival_document(result: RigResults, contest: Contest, rival: Rival) -> dict[str, Any]:
    run = result.rivals.get(rival.name)
    row: dict[str, Any] = {"rival": rival.name, "description": rival.description, "about": rival.about}
    if run is None:
        return row | {"missing": rival.coder.missing() or NOT_RUN}
    name = rival_file(result.bench, contest.source, rival).name
    return row | {"run": f"runs/{name}", "how": run.coder, "figures": asdict(point_of_rival(run))}
