"""Runs what a report asks of its rigs, and writes it: Markdown with pictures, and the same figures as JSON.

Everything lies in one folder and refers to itself by relative links: NAME.md, NAME.json, pictures/, runs/.
Runs are made rig by rig and kept as they come; writing takes a second, so that it is always done from what is there.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, TextIO

from decogs.formats.errors import TrainingError, UsageError

from . import choices, paper, rates
from .machine import code_version, machine_facts
from .perceptual import installed_network
from .plots import plot_effort, plot_quality, plot_rates, plot_scanlines, require_plots
from .progress import BenchProgress
from .rival_runs import RatePoint, RivalRun, find_rival, point_of, point_of_rival, rival_file, run_rival
from .rivals.sequences import Rival
from .runs import KEYFRAME, BenchOptions, RigBench, Run
from .tables import (
    COLUMNS,
    NOT_RUN,
    NOTHING,
    cpu_seconds,
    drift,
    figures,
    flicker,
    markdown,
    mean_of,
    number,
    wall_seconds,
    with_error,
)
from .variants import Question, Variant

OnWarning = Callable[[str], None]

NONE = "none"
"""For ``only``: nothing is run, the report is written from what is there."""


@dataclass(frozen=True)
class Contest:
    """The encoder's rates, finest first, and rivals that keep the frames of the finest; ``key`` for ``--only``."""

    key: str
    rates: tuple[Variant, ...]
    rivals: tuple[Rival, ...]

    @property
    def source(self) -> Variant:
        return self.rates[0]


@dataclass(frozen=True)
class Plan:
    """A kind of report: its name (of the files, too), heading, questions, and figures with the variants they show."""

    name: str
    title: str
    questions: tuple[Question, ...]
    figures: Mapping[str, tuple[Variant, ...]] = field(default_factory=dict)
    contest: Contest | None = None

    @property
    def lent(self) -> tuple[Variant, ...]:
        """Variants whose streams are needed after their own run."""
        return (KEYFRAME,) if self.contest is None else (KEYFRAME, self.contest.source)


PAPER = Plan("paper", "DecoGS and its baseline, measured", paper.QUESTIONS, paper.FIGURES)
CHOICES = Plan("choices", "Choices, measured", choices.QUESTIONS)
RATES = Plan(
    "rates",
    "Rate and distortion, measured",
    rates.QUESTIONS,
    rates.FIGURES,
    Contest(rates.RIVALS_PART, rates.RATE_POINTS, rates.RIVALS),
)
PLANS = {plan.name: plan for plan in (PAPER, CHOICES, RATES)}


@dataclass
class _RigResults:
    """A rig's runs by key, what went wrong by the variant's or rival's name, and rivals by theirs."""

    bench: RigBench
    runs: dict[str, Run] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)
    rivals: dict[str, RivalRun] = field(default_factory=dict)

    def run_of(self, variant: Variant) -> Run | None:
        return self.runs.get(self.bench.key(variant))

    def is_preset(self, variant: Variant) -> bool:
        return self.bench.key(variant) in (self.bench.key(Variant("", "")), self.bench.key(KEYFRAME))


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
    if plan.figures:
        require_plots()
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder}: is a file; name a folder for the report")
    results = [_RigResults(RigBench(rig_dir, folder, options)) for rig_dir in rig_dirs]
    _check_names([result.bench for result in results])
    folder.mkdir(parents=True, exist_ok=True)
    _run_missing(results, wanted, plan.lent, terminal, on_warning)
    if plan.contest is not None:
        if not only or plan.contest.key in only:
            _run_rivals(results, plan.contest, terminal, on_warning)
        for result in results:
            _gather_rivals(result, plan.contest)
    for result in results:
        _gather(result, [*(v for question in plan.questions for v in question.variants), KEYFRAME])
        result.bench.tidy(plan.lent)
    lines = _markdown(plan, results, folder, command)
    path = folder / f"{plan.name}.md"
    (folder / f"{plan.name}.json").write_text(json.dumps(_document(plan, results, command), indent=1) + "\n", "utf-8")
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return path


def _wanted(plan: Plan, only: Sequence[str]) -> list[Variant]:
    """The variants to run, in the order of their first question."""
    sets = {question.key: question.variants for question in plan.questions} | dict(plan.figures)
    if plan.contest is not None:
        sets[plan.contest.key] = (plan.contest.source,)
    for key in only:
        if key != NONE and key not in sets:
            raise UsageError(f"--only {key}: there is no such part; choose from {', '.join(sets)}, {NONE}")
    chosen = [variants for key, variants in sets.items() if not only or key in only]
    return [variant for variants in chosen for variant in variants]


def _check_names(benches: Sequence[RigBench]) -> None:
    """Results are kept by the name of the rig's folder."""
    seen: dict[str, RigBench] = {}
    for bench in benches:
        if bench.name in seen:
            raise UsageError(
                f"{bench.rig.path}: {seen[bench.name].rig.path} has the same name; give each its own report"
            )
        seen[bench.name] = bench


def _run_missing(
    results: Sequence[_RigResults],
    wanted: Sequence[Variant],
    lent: Sequence[Variant],
    terminal: TextIO | None,
    on_warning: OnWarning | None,
) -> None:
    missing = [(result, _missing(result.bench, wanted)) for result in results]
    frames = sum(len(result.bench.frames_of(variant)) for result, variants in missing for variant in variants)
    with BenchProgress(frames, terminal) as progress:
        for result, variants in missing:
            for variant in variants:
                progress.started(result.bench.name, variant.name)
                try:
                    run = result.bench.run(
                        variant,
                        on_frame=progress.frame,
                        on_keyframe_step=progress.keyframe_step,
                        keep_stream=variant in lent,
                    )
                except TrainingError as error:
                    result.failures[variant.name] = str(error)
                    if on_warning:
                        on_warning(f"{result.bench.name} {variant.name}: {error}")
                else:
                    progress.finished(run)


def _run_rivals(
    results: Sequence[_RigResults], contest: Contest, terminal: TextIO | None, on_warning: OnWarning | None
) -> None:
    """Those of which no result is there and that can be tried here; a source that cannot be trained has none."""
    here = [rival for rival in contest.rivals if rival.coder.missing() is None]
    missing = [
        (result, [rival for rival in here if find_rival(result.bench, contest.source, rival) is None])
        for result in results
        if contest.source.name not in result.failures
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


def _gather_rivals(result: _RigResults, contest: Contest) -> None:
    for rival in contest.rivals:
        run = find_rival(result.bench, contest.source, rival)
        if run is not None:
            result.rivals[rival.name] = run


def _missing(bench: RigBench, wanted: Sequence[Variant]) -> list[Variant]:
    """Those of which no result is there, each run once, whatever its names."""
    first: dict[str, Variant] = {}
    for variant in wanted:
        first.setdefault(bench.key(variant), variant)
    return [variant for variant in first.values() if bench.find(variant) is None]


def _gather(result: _RigResults, variants: Sequence[Variant]) -> None:
    for variant in variants:
        run = result.bench.find(variant)
        if run is not None:
            result.runs[run.key] = run


def _markdown(plan: Plan, results: Sequence[_RigResults], folder: Path, command: str) -> list[str]:
    made = f"Made by `{command}`. " if command else ""
    lines = [f"# {plan.title}", "", f"{made}Every row links to its run; the last section says how it was measured.", ""]
    if plan is PAPER:
        lines += _summary(results)
    for result in results:
        lines += _rig_section(plan, result, folder)
    return lines + _how(plan, results)


def _summary(results: Sequence[_RigResults]) -> list[str]:
    """DecoGS against the baseline, rig by rig: what the paper claims, as ratios."""
    rows = []
    for result in results:
        baseline = result.run_of(paper.BASELINE)
        for variant in (paper.DECOGS, paper.DECOGS_PAPER):
            run = result.run_of(variant)
            if run is not None and baseline is not None:
                rows.append([result.bench.name, variant.description, *_comparison(run, baseline)])
    if not rows:
        return []
    headings = [
        "rig", "method", "dynamic PSNR over the baseline's, dB", "mTV ×100 / baseline's",
        "s/frame / baseline's", "CPU-s/frame / baseline's", "slope, dB per 100 frames", "slope dynamic",
    ]  # fmt: skip
    return ["## DecoGS against the baseline", "", *markdown(headings, rows), ""]


def _comparison(run: Run, baseline: Run) -> list[str]:
    gain = _both(mean_of(run, "psnr_dynamic"), mean_of(baseline, "psnr_dynamic"), lambda a, b: f"{a - b:+.2f}")
    still = _both(flicker(run), flicker(baseline), lambda a, b: f"{a:.4f} / {b:.4f}{_ratio(a, b)}")
    wall = _both(wall_seconds(run), wall_seconds(baseline), lambda a, b: f"{a:.2f} / {b:.2f}{_ratio(a, b)}")
    cpu = _both(cpu_seconds(run), cpu_seconds(baseline), lambda a, b: f"{a:.2f} / {b:.2f}{_ratio(a, b)}")
    return [gain, still, wall, cpu, with_error(drift(run, "psnr")), with_error(drift(run, "psnr_dynamic"))]


def _both(a: float | None, b: float | None, write: Callable[[float, float], str]) -> str:
    return NOTHING if a is None or b is None else write(a, b)


def _ratio(a: float, b: float) -> str:
    return f" = 1/{b / a:.1f}" if a > 0 and b > 0 else ""


def _rig_section(plan: Plan, result: _RigResults, folder: Path) -> list[str]:
    bench = result.bench
    lines = [f"## {bench.name}", "", _about_rig(result), ""]
    for question in plan.questions:
        lines += [f"### {question.title}", ""] + ([question.about, ""] if question.about else [])
        for columns in question.columns:
            lines += [*_table(result, question, columns), ""]
        lines += [f"{name} failed: {error}" for name, error in _failed(result, question)]
    if plan.contest is not None:
        lines += _contest_section(plan.contest, result)
    return lines + (_figures(plan, result, folder) if plan.figures else [])


def _about_rig(result: _RigResults) -> str:
    bench = result.bench
    camera = next(camera for camera in bench.rig.cameras if camera.name == bench.camera)
    regions, frames = bench.regions, bench.frames
    text = (
        f"{len(bench.rig.cameras) - 1} training views, {bench.camera} held out ({camera.width}x{camera.height}"
        f"{'' if bench.options.scale == 1 else f', scale {bench.options.scale:g}'}), frames {frames.start} to "
        f"{frames[-1]}. Static {regions.static.mean():.1%} of its pixels, dynamic {regions.dynamic.mean():.1%}: "
        f"{regions.about}."
    )
    keyframe = result.run_of(KEYFRAME)
    if keyframe is not None:
        first = keyframe.frames[0]
        text += (
            f" Shared keyframe: preset {keyframe.preset}, {first.gaussians} Gaussians, {first.bytes} bytes, "
            f"{sum(first.seconds.values()):.0f} s ({_link(bench, keyframe)})."
        )
    return text


def _table(result: _RigResults, question: Question, columns: Sequence[str]) -> list[str]:
    runs = [run for variant in question.variants if (run := result.run_of(variant)) is not None]
    rows = []
    for variant in question.variants:
        run = result.run_of(variant)
        label = variant.description + (" (the preset)" if result.is_preset(variant) else "")
        if run is None:
            missing = "failed" if variant.name in result.failures else NOT_RUN
            rows.append([label, *([NOTHING] * len(columns)), missing])
        else:
            rows.append([label, *(COLUMNS[key].value(run, runs) for key in columns), _link(result.bench, run)])
    return markdown(["", *(COLUMNS[key].heading for key in columns), "how"], rows)


def _contest_section(contest: Contest, result: _RigResults) -> list[str]:
    """The encoder's rates and, kept in other ways, the frames of its source."""
    bench, source = result.bench, result.run_of(contest.source)
    rows = [
        _rate_row(point_of(run, f"decogs, {variant.description}"), source, _link(bench, run))
        for variant in contest.rates
        if (run := result.run_of(variant)) is not None
    ]
    notes: dict[str, list[str]] = {}
    for rival in contest.rivals:
        kept = result.rivals.get(rival.name)
        if kept is None:
            why = result.failures.get(rival.name, rival.coder.missing() or NOT_RUN)
            rows.append([rival.description, *[NOTHING] * 7, why])
        else:
            link = f"[{rival.name}](runs/{rival_file(bench, contest.source, rival).name})"
            rows.append(_rate_row(point_of_rival(kept), source, link))
        if rival.about:
            notes.setdefault(rival.about, []).append(rival.name)
    headings = [
        "", "PSNR", "dynamic", "static", "first frame, kB", "kB/frame after it", "× ours", "kB/frame, all", "how",
    ]  # fmt: skip
    return [
        "### Against other ways to keep the same frames",
        "",
        f"Rivals keep the decoded frames of “{contest.source.description}”, the first row; they are read again from "
        "what they wrote, rendered and measured like a stream. Those frames lie on our lattice already, which helps a "
        "general-purpose compressor.",
        "",
        *markdown(headings, rows),
        "",
        *(f"- {', '.join(names)}: {about}" for about, names in notes.items()),
        "",
    ]


def _rate_row(point: RatePoint, source: Run | None, link: str) -> list[str]:
    ours = None if source is None else point_of(source, "").later_bytes
    times = None if not ours else point.later_bytes / ours
    quality = [number(".2f")(value) for value in (point.psnr, point.psnr_dynamic, point.psnr_static)]
    sizes = [f"{value / 1e3:.2f}" for value in (point.first_bytes, point.later_bytes, point.frame_bytes)]
    return [point.label, *quality, sizes[0], sizes[1], number(".2f")(times), sizes[2], link]


def _failed(result: _RigResults, question: Question) -> list[tuple[str, str]]:
    names = {variant.name for variant in question.variants}
    return [(name, error) for name, error in result.failures.items() if name in names]


def _link(bench: RigBench, run: Run) -> str:
    return f"[{run.variant}](runs/{bench.file_of(run).name})"


def _figures(plan: Plan, result: _RigResults, folder: Path) -> list[str]:
    """Draws the rig's figures from the runs there are."""
    bench = result.bench
    pictures = folder / "pictures"
    pictures.mkdir(exist_ok=True)
    lines: list[str] = []
    curve = _labelled(result, plan.figures.get(rates.CURVES, ()))
    if curve:
        name = f"{bench.name}-rates.png"
        points = [point_of(run, label) for label, run in curve.items()]
        plot_rates(pictures / name, points + [point_of_rival(run) for run in result.rivals.values()])
        lines += ["### Rate and distortion", "", f"![PSNR over bytes per frame](pictures/{name})", ""]
    over_time = _labelled(result, plan.figures.get(paper.TIME, ()))
    if over_time:
        quality, effort = f"{bench.name}-quality.png", f"{bench.name}-effort.png"
        plot_quality(pictures / quality, over_time)
        plot_effort(pictures / effort, over_time)
        lines += ["### Over time", "", f"![PSNR of every frame](pictures/{quality})", ""]
        lines += [f"![share of Gaussians trained, and processor seconds](pictures/{effort})", ""]
    followed = _labelled(result, plan.figures.get(paper.SCANLINES, ()))
    if followed:
        name = f"{bench.name}-scanlines.png"
        strips = {"recorded": bench.recorded_column()}
        strips |= {label: bench.column_of(run) for label, run in followed.items()}
        plot_scanlines(pictures / name, strips, bench.column, bench.frames.start)
        lines += ["### Space-time scanlines", ""]
        lines += [
            f"Column {bench.column} of {bench.camera}, mostly static, from frame to frame. Above as it is; below how "
            "far each pixel strays from its own mean over time: what is static should be plain grey.",
            "",
            f"![a column of pixels over time](pictures/{name})",
            "",
        ]
    return lines


def _labelled(result: _RigResults, variants: Sequence[Variant]) -> dict[str, Run]:
    found = {variant.description: result.run_of(variant) for variant in variants}
    return {label: run for label, run in found.items() if run is not None}


def _how(plan: Plan, results: Sequence[_RigResults]) -> list[str]:
    """How the figures were obtained: once for all, with what differs between runs as a range."""
    runs = [run for result in results for run in result.runs.values()]
    used = dict.fromkeys(key for question in plan.questions for columns in question.columns for key in columns)
    lines = ["## How these figures were obtained", ""]
    if runs:
        lines += [*_circumstances(runs), ""]
    lines += [
        "The stream of each run is decoded from its file and the held-out camera's view of every frame rendered at its "
        "own size, lens distortion included, and rounded to 8 bit as `decogs-decode` writes it; the recorded frame is "
        "8 bit as well. Pictures count from 0 to 1.",
        "",
        "- PSNR: of the mean square error over the pixels of a region and the three channels; the mean of the frames' "
        "values, the shared keyframe included.",
        "- SSIM: 11x11 Gaussian window of sigma 1.5, zero outside the picture, C1 = 0.01², C2 = 0.03², on RGB; the map "
        "of the whole picture is averaged over the region.",
        "- mTV ×100: |I(t+1) − I(t)| of the rendered 8-bit pictures, mean over static pixels and channels, mean over "
        "t, times 100 (Yun 2025, its code's definition). Its authors mark static pixels by hand; where a rig ships no "
        "masks, ours are told from the recording, so that such figures compare within this report only.",
        f"- LPIPS: {_about_lpips(runs)}.",
        "- Static and dynamic regions: as said at each rig; the same for all its rows; pixels in between count in "
        "neither.",
        "- Time: of the encoding process, from decoded pictures to the written packet, measuring left out. Rows ran "
        "one after the other: compare processor seconds where the load was high.",
        "- Render FPS: the median over frames, projection to picture, all threads of the run; reading the packet is "
        "not in it (`read_seconds` in the run's file).",
        "- MB, kB: 10^6, 10^3 bytes on disk.",
        *(_how_rivals() if plan.contest is not None else []),
        "- One run and one seed for each row: differences below 0.1 dB mean little.",
        "",
        "Columns:",
        "",
        *(f"- {COLUMNS[key].heading}: {COLUMNS[key].meaning}" for key in used),
    ]
    return lines


def _how_rivals() -> list[str]:
    return [
        "- First frame: all bytes that have to be there before it shows: of a stream the keyframe with header and "
        "index, of a file per frame the first file. The frames after it: the other bytes over the other frames. "
        "× ours: those over the finest stream's.",
        "- Rivals are written to disk by this program (PLY, SPZ, .splat and arrays by writers of its own, splats4d by "
        "its own command at zstd level 19) and sizes taken from the files.",
    ]


def _circumstances(runs: Sequence[Run]) -> list[str]:
    machines = {f"{run.machine['cpu']}, {run.machine['cores']} cores" for run in runs}
    threads, seeds = {run.threads for run in runs}, {run.seed for run in runs}
    dates, loads = sorted(run.date for run in runs), [value for run in runs for value in run.load]
    lines = [
        f"- Machine: {'; '.join(sorted(machines))}; {_listed(threads)} threads; no GPU. Load average while running: "
        f"{min(loads):.1f} to {max(loads):.1f}.",
        f"- Seed {_listed(seeds)}; runs of {dates[0]} to {dates[-1]}; code {_listed({run.code for run in runs})}.",
        "- Each run's file says the rest: command, settings, frame by frame figures. Paths in a command are names; "
        "what stands in brackets after it has no option and is set from Python.",
    ]
    if {run.code for run in runs} != {code_version()}:
        lines.append(f"- Written with other code than some runs were made with: now {code_version()}.")
    return lines


def _listed(values: set[Any]) -> str:
    return ", ".join(str(value) for value in sorted(values))


def _about_lpips(runs: Sequence[Run]) -> str:
    networks = {run.lpips_network for run in runs if run.lpips_network} or {installed_network()} - {None}
    return f"version 0.1, network {_listed(networks)}" if networks else "its package or weights are not installed here"


def _document(plan: Plan, results: Sequence[_RigResults], command: str) -> dict[str, Any]:
    """The report as data: figures as numbers, rows by question; runs/ has them frame by frame."""
    return {
        "report": plan.name,
        "command": command,
        "written": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "code": code_version(),
        "machine": machine_facts(),
        "rigs": {result.bench.name: _rig_document(plan, result) for result in results},
    }


def _rig_document(plan: Plan, result: _RigResults) -> dict[str, Any]:
    bench, regions = result.bench, result.bench.regions
    document: dict[str, Any] = {
        "held_out": bench.camera,
        "frames": [bench.frames.start, bench.frames.stop],
        "masks": regions.about,
        "static_share": float(regions.static.mean()),
        "dynamic_share": float(regions.dynamic.mean()),
        "failures": result.failures,
        "questions": {
            question.key: [_row_document(result, variant) for variant in question.variants]
            for question in plan.questions
        },
    }
    if plan.contest is not None:
        document[plan.contest.key] = [_rival_document(result, plan.contest, rival) for rival in plan.contest.rivals]
    return document


def _row_document(result: _RigResults, variant: Variant) -> dict[str, Any]:
    run = result.run_of(variant)
    row: dict[str, Any] = {"variant": variant.name, "description": variant.description}
    if run is not None:
        row |= {"run": f"runs/{result.bench.file_of(run).name}", "how": run.command, "figures": figures(run)}
    return row


def _rival_document(result: _RigResults, contest: Contest, rival: Rival) -> dict[str, Any]:
    run = result.rivals.get(rival.name)
    row: dict[str, Any] = {"rival": rival.name, "description": rival.description, "about": rival.about}
    if run is None:
        return row | {"missing": rival.coder.missing() or NOT_RUN}
    name = rival_file(result.bench, contest.source, rival).name
    return row | {"run": f"runs/{name}", "how": run.coder, "figures": asdict(point_of_rival(run))}
