"""A report as Markdown: a section for each rig with a table for each question, pictures, and how it was measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..estimates import NOTHING, about_seeds
from ..machine import code_version
from ..measures.perceptual import installed_network
from ..measures.regions import measured_size
from ..questions import paper, rates
from ..questions.variants import Question, Variant
from ..runs.results import RigResults
from ..runs.rig_bench import RigBench
from ..runs.rivals import RatePoint, point_of, point_of_rival, rival_file
from ..runs.run import KEYFRAME, Run
from ..tables.bd_rates import ABOUT, bd_rate_table, bd_rates
from ..tables.columns import COLUMNS, NOT_RUN, markdown, number, psnr_of_cameras
from ..tables.differences import difference_table
from .plans import Contest, Plan
from .plots import ErrorMaps, plot_effort, plot_errors, plot_quality, plot_rates, plot_scanlines, plot_trade
from .trade import QUALITY, points_of

_RATE_HEADINGS = (
    "", "PSNR", "dynamic", "static", "subject", "mTV ×100", "first frame, kB", "s to it at 2 Mbit/s",
    "s to a usable picture", "kB/frame after it", "× ours", "kB/frame, all", "CPU-ms to read", "how",
)  # fmt: skip


def report_page(plan: Plan, results: Sequence[RigResults], folder: Path, command: str) -> list[str]:
    """The page's lines; draws the pictures it shows into the ``folder``."""
    made = f"Made by `{command}`. " if command else ""
    about = "Each row names its files in runs/, one for each seed; the last section says how it was measured."
    lines = [f"# {plan.title}", "", f"{made}{about}", ""]
    if plan.summary is not None:
        lines += plan.summary(results)
    for result in results:
        lines += _rig_section(plan, result, folder)
    return lines + _how(plan, results)


def _rig_section(plan: Plan, result: RigResults, folder: Path) -> list[str]:
    bench = result.bench
    lines = [f"## {bench.name}", "", _about_rig(result), ""]
    untouched = [question for question in plan.questions if _is_untouched(result, question)]
    for question in (question for question in plan.questions if question not in untouched):
        lines += [f"### {question.title}", ""] + ([question.about, ""] if question.about else [])
        for columns in question.columns:
            lines += [*_table(result, question, columns), ""]
        lines += difference_table(result, question)
        lines += [f"{name} failed: {error}" for name, error in _failed(result, question)]
    if untouched:
        lines += [f"Not run: {'; '.join(question.title for question in untouched)}.", ""]
    if plan.contest is not None:
        lines += _contest_section(plan.contest, result)
    if plan.front:
        lines += _front_section(plan, result, folder)
    return lines + (_figures(plan, result, folder) if plan.figures else [])


def _is_untouched(result: RigResults, question: Question) -> bool:
    """Whether all that is there of a question is the preset's row, which other questions have, too."""
    measured = [variant for variant in question.variants if result.runs_of(variant)]
    missing = len(measured) < len(question.variants) and not _failed(result, question)
    return bool(result.runs) and missing and all(result.is_preset(variant) for variant in measured)


def _about_rig(result: RigResults) -> str:
    bench = result.bench
    regions, frames = bench.regions, bench.frames
    training = len(bench.rig.cameras) - len(bench.cameras)
    size = measured_size(bench.rig, bench.camera, bench.options.scale)
    text = (
        f"{training} training views, {', '.join(bench.cameras)} held out ({size}), "
        f"frames {frames.start} to "
        f"{frames[-1]}. Static {regions.static.mean():.1%} of {bench.camera}'s pixels, dynamic "
        f"{regions.dynamic.mean():.1%}: {regions.about}."
    )
    keyframe = result.run_of(KEYFRAME)
    if keyframe is not None:
        first = keyframe.frames[0]
        text += (
            f" Shared keyframe, seed {keyframe.seed}: preset {keyframe.preset}, {first.gaussians} Gaussians, "
            f"{first.bytes} bytes, "
            f"{sum(first.seconds.values()):.0f} s ({_files(bench, [keyframe])})."
        )
    return text


def _table(result: RigResults, question: Question, columns: Sequence[str]) -> list[str]:
    seeds = len(result.bench.options.seeds)
    runs_of = {variant.name: list(result.runs_of(variant).values()) for variant in question.variants}
    table = [run for runs in runs_of.values() for run in runs]
    rows = []
    for variant in question.variants:
        runs = runs_of[variant.name]
        label = variant.description + (" (the preset)" if result.is_preset(variant) else "")
        if not runs:
            missing = "failed" if variant.name in result.failures else NOT_RUN
            rows.append([label, *([NOTHING] * len(columns)), missing])
        else:
            how = _files(result.bench, runs) + ("" if len(runs) == seeds else f" ({len(runs)} of {seeds} seeds)")
            rows.append([label, *(COLUMNS[key].value(runs, table) for key in columns), how])
    return markdown(["", *(COLUMNS[key].heading for key in columns), "how"], rows)


def _contest_section(contest: Contest, result: RigResults) -> list[str]:
    """The encoder's rates and, kept in other ways, the frames of its source."""
    bench, source = result.bench, result.run_of(contest.source)
    rows = [
        _rate_row(point_of(run, f"decogs, {variant.description}"), source, _files(bench, [run]))
        for variant in contest.rates
        if (run := result.run_of(variant)) is not None
    ]
    notes: dict[str, list[str]] = {}
    for rival in contest.rivals:
        kept = result.rivals.get(rival.name)
        if kept is None:
            why = result.failures.get(rival.name, rival.coder.missing() or NOT_RUN)
            rows.append([rival.description, *[NOTHING] * (len(_RATE_HEADINGS) - 2), why])
        else:
            name = f"`{rival_file(bench, contest.source, rival).stem}`"
            rows.append(_rate_row(point_of_rival(kept), source, name))
        if rival.about:
            notes.setdefault(rival.about, []).append(rival.name)
    return [
        "### Against other ways to keep the same frames",
        "",
        f"Rivals keep the decoded frames of “{contest.source.description}”, the first row; they are read again from "
        "what they wrote, rendered and measured like a stream. Those frames lie on our lattice already, which helps a "
        "general-purpose compressor. Rows are of the first seed.",
        "",
        *markdown(_RATE_HEADINGS, rows),
        "",
        *(f"- {', '.join(names)}: {about}" for about, names in notes.items()),
        "",
        *_bd_rates(contest, result),
    ]


def _bd_rates(contest: Contest, result: RigResults) -> list[str]:
    """Rivals' curves against the anchor's."""
    points = result.rate_points({variant.description: variant for variant in contest.rates})
    rows = bd_rates(points, contest.anchor)
    return [f"### BD-rate against {contest.anchor}", "", ABOUT, "", *bd_rate_table(rows), ""] if rows else []


def _front_section(plan: Plan, result: RigResults, folder: Path) -> list[str]:
    """A picture of what is best for its price."""
    points = points_of(plan.questions, result)
    if not points:
        return []
    (folder / "pictures").mkdir(exist_ok=True)
    name = f"{result.bench.name}-curve-{QUALITY.key.replace('_', '-')}.png"
    plot_trade(folder / "pictures" / name, points, {question.key: question.title for question in plan.questions})
    return [
        "### What is best for its price",
        "",
        f"![{QUALITY.label}, over cost](pictures/{name})",
        "",
        "Rows far below the worst preset leave this picture; the tables above have them.",
        "",
    ]


def _rate_row(point: RatePoint, source: Run | None, name: str) -> list[str]:
    ours = None if source is None else point_of(source, "").later_bytes
    times = None if not ours else point.later_bytes / ours
    dbs = (point.psnr, point.psnr_dynamic, point.psnr_static, point.psnr_subject)
    first, later, every = (f"{value / 1e3:.2f}" for value in (point.first_bytes, point.later_bytes, point.frame_bytes))
    return [
        point.label,
        *map(number(".2f"), dbs),
        number(".4f")(point.mtv),
        first,
        f"{point.first_seconds:.2f}",
        number(".2f")(point.usable_seconds),
        later,
        number(".2f")(times),
        every,
        number(".1f")(point.read_ms),
        name,
    ]


def _failed(result: RigResults, question: Question) -> list[tuple[str, str]]:
    names = {variant.name for variant in question.variants}
    return [(name, error) for name, error in result.failures.items() if name in names]


def _files(bench: RigBench, runs: Sequence[Run]) -> str:
    """The names of the runs' JSONs in runs/, keys of one name in braces; no link: runs are published as an archive."""
    names: dict[str, list[str]] = {}
    for run in runs:
        names.setdefault(bench.file_of(run).stem.removesuffix(run.key), []).append(run.key)
    keys = {
        name: f"{{{','.join(keys_of_name)}}}" if len(keys_of_name) > 1 else keys_of_name[0]
        for name, keys_of_name in names.items()
    }
    return ", ".join(f"`{name}{keys_of_name}`" for name, keys_of_name in keys.items())


def _figures(plan: Plan, result: RigResults, folder: Path) -> list[str]:
    """Draws the rig's figures from the runs there are."""
    bench = result.bench
    pictures = folder / "pictures"
    pictures.mkdir(exist_ok=True)
    lines: list[str] = []
    curve = {variant.description: variant for variant in plan.figures.get(rates.CURVES, ())}
    if any(map(result.run_of, curve.values())):
        name = f"{bench.name}-rates.png"
        plot_rates(pictures / name, result.rate_points(curve))
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
    return lines + _error_maps(result, pictures, _labelled(result, plan.figures.get(paper.ERRORS, ())))


def _error_maps(result: RigResults, pictures: Path, runs: Mapping[str, Run]) -> list[str]:
    """Where each run is wrong, camera by camera; runs that an older bench measured have no maps."""
    bench = result.bench
    mapped = [
        ErrorMaps(label, maps, dict(zip(bench.cameras, psnr_of_cameras(run), strict=True)))
        for label, run in runs.items()
        if (maps := bench.errors_of(run))
    ]
    if not mapped:
        return []
    name = f"{bench.name}-errors.png"
    plot_errors(pictures / name, {camera: bench.recorded_first(camera) for camera in bench.cameras}, mapped)
    return [
        "### Where the errors are",
        "",
        "Every held-out camera: what it recorded in the first frame, and how far each pixel is from what was recorded, "
        "the root of the mean square over all frames and the three channels, in 8-bit levels. One scale for all; its "
        "end is what one pixel in two hundred exceeds. PSNR is the mean over frames.",
        "",
        f"![errors of every held-out camera](pictures/{name})",
        "",
    ]


def _labelled(result: RigResults, variants: Sequence[Variant]) -> dict[str, Run]:
    runs = {variant.description: result.run_of(variant) for variant in variants}
    return {label: run for label, run in runs.items() if run is not None}


def _how(plan: Plan, results: Sequence[RigResults]) -> list[str]:
    """How the figures were obtained: once for all, with what differs between runs as a range."""
    runs = [run for result in results for run in result.runs.values()]
    used = dict.fromkeys(key for question in plan.questions for columns in question.columns for key in columns)
    lines = ["## How these figures were obtained", ""]
    if runs:
        lines += [*_circumstances(runs), ""]
    lines += [
        "The stream of each run is decoded from its file and the held-out camera's view of every frame rendered at the "
        "size stated for its rig, lens distortion included, and rounded to 8 bit as `decogs-decode` writes it; the "
        "recorded frame is 8 bit as well. Pictures count from 0 to 1.",
        "",
        "- PSNR: of the mean square error over the pixels of a region and the three channels; the mean of the frames' "
        "values, the shared keyframe included.",
        "- SSIM: 11x11 Gaussian window of sigma 1.5, zero outside the picture, C1 = 0.01², C2 = 0.03², on RGB; the map "
        "of the whole picture is averaged over the region.",
        "- mTV ×100: |I(t+1) − I(t)| of the rendered 8-bit pictures, mean over static pixels and channels, mean over "
        "t, times 100 (Yun 2025, its code's definition). Its authors mark static pixels by hand; where a rig ships no "
        "masks, ours are determined from the recording, so that such figures compare within this report only.",
        f"- LPIPS: {_about_lpips(runs)}.",
        "- Static and dynamic regions: as said at each rig; the same for all its rows; pixels in between count in "
        "neither.",
        "- Time: of the encoding process, from decoded pictures to the written packet, measuring left out. Rows ran "
        "one after the other: compare processor seconds where the load was high.",
        "- Render FPS: the median over frames, projection to picture, all threads of the run; reading the packet is "
        "not in it (`read_seconds` in the run's file).",
        "- MB, kB: 10^6, 10^3 bytes on disk.",
        *(_how_rivals() if plan.contest is not None else []),
        *_about_seeds(results[0].bench.options.seeds),
        "",
        "Columns:",
        "",
        *(f"- {COLUMNS[key].heading}: {COLUMNS[key].meaning}" for key in used),
    ]
    return lines


def _about_seeds(seeds: Sequence[int]) -> list[str]:
    lines = [f"- {about_seeds(seeds)}"]
    if len(seeds) > 1:
        lines += [
            "- Differences are taken seed by seed and then averaged, so that what all rows of a seed have in common, "
            "such as their keyframe, drops out. “gains”, “costs” and bold: larger than two standard errors. With three "
            "seeds 18 % of the differences between equal rows are, by chance: trust what two rigs agree on. Last "
            "frame: the dynamic region's PSNR there; bytes, CPU-s: of a later frame.",
            f"- Pictures of single runs and rivals are of seed {seeds[0]}.",
        ]
    return lines


def _how_rivals() -> list[str]:
    return [
        "- First frame: all bytes that have to be there before it shows: of a stream the keyframe with header and "
        "index, of a file per frame the first file. The frames after it: the other bytes over the other frames. "
        "× ours: those over the finest stream's. Seconds to it: what the line alone takes to bring it. Seconds to a "
        "usable picture: until the first frame is seen in full, with the processor time of reading and rendering it, "
        "as on one core that begins when all of it is there.",
        "- Subject: inside the rig's true mattes of the held-out camera, frame by frame.",
        "- CPU-ms to read: processor milliseconds from bytes to a frame's Gaussians, the mean over all frames, without "
        "rendering. It is of the programs at hand: streams, PLY, SPZ, SOG, .splat and arrays by our readers; splats4d "
        "by its command, which is started for each frame; 4dgs by its package, in numpy.",
        "- Rivals are written to disk by this program (PLY, SPZ, SOG, .splat and arrays by writers of its own, "
        "splats4d by its own command at zstd level 19, 4dgs by its package) and sizes taken from the files.",
    ]


def _circumstances(runs: Sequence[Run]) -> list[str]:
    machines = {f"{run.machine['cpu']}, {run.machine['cores']} cores" for run in runs}
    threads, seeds = {run.threads for run in runs}, {run.seed for run in runs}
    dates, loads = sorted(run.date for run in runs), [value for run in runs for value in run.load]
    lines = [
        f"- Machine: {'; '.join(sorted(machines))}; {_listed(threads)} threads; no GPU. Load average while running: "
        f"{min(loads):.1f} to {max(loads):.1f}.",
        f"- Seeds: {_listed(seeds)}; runs of {dates[0]} to {dates[-1]}; code {_listed({run.code for run in runs})}.",
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
