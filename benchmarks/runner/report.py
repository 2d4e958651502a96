"""The page of a run: machine, tables, where a peer is better, pictures."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from pathlib import Path

from benchmarks.runner.cases import BenchmarkRecord
from benchmarks.runner.plots import THING, as_error, drawn_errors, grouped, write_plots
from heartcase.schemas.files import atomic_write

__all__ = ["write_report"]

DICE_MARGIN = 0.01
"""How much more overlap a peer needs to count as better."""
DISTANCE_MARGIN_MM = 0.1
"""How much nearer a peer must be to count as better."""


def write_report(records: Sequence[BenchmarkRecord], skipped: Sequence[tuple[str, str, str]], directory: Path) -> Path:
    """Write a page, ``benchmarks.md``, with the machine, tables and the pictures of :func:`write_plots`.

    Parameters
    ----------
    records
        What was measured, in one run on one machine.
    skipped
        Case, method and reason of what was left out.
    directory
        Made when it is not there.

    Returns
    -------
    Path
        The page.
    """
    lines = ["# Run time against error", ""]
    if records:
        lines += [f"heartcase {records[0].version} on {records[0].machine}.", ""]
        lines += ["Times are medians after a warm-up, good as ratios within this page.", ""]
    for title, part in grouped(records, lambda record: record.group or record.case).items():
        lines += [f"## {title}", ""]
        lines += _case_table(part) if part[0].group is None else _sweep_tables(part)
        for path in write_plots(part, directory):
            lines += [f"![{path.stem.replace('-', ' ')}]({path.name})", ""]
    if skipped:
        lines += ["## Left out", ""]
        for (method, reason), missing in grouped(skipped, lambda item: (item[1], item[2])).items():
            lines.append(f"- {method}, {len(missing)} cases from {missing[0][0]} to {missing[-1][0]}: {reason}")
        lines.append("")
    page = directory / "benchmarks.md"
    directory.mkdir(parents=True, exist_ok=True)
    atomic_write(page, "\n".join(lines).encode())
    return page


def _case_table(records: Sequence[BenchmarkRecord]) -> list[str]:
    """A column for each method, a row for each figure."""
    lines = ["| | " + " | ".join(record.method for record in records) + " |", "|---|" + "---|" * len(records)]
    lines.append("| time [s] | " + " | ".join(f"{record.seconds:.4g}" for record in records) + " |")
    memory = [f"{record.peak_memory_mb:,.0f}" if record.peak_memory_mb is not None else "" for record in records]
    lines.append("| largest memory [MB] | " + " | ".join(memory) + " |")
    for name in dict.fromkeys(name for record in records for name in record.errors):
        cells = [f"{record.errors[name]:.4g}" if name in record.errors else "" for record in records]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return [*lines, ""]


def _sweep_tables(records: Sequence[BenchmarkRecord]) -> list[str]:
    """For each thing that is measured a table: a row for each case, a column for each method; then where ours loses."""
    errors = drawn_errors(records)
    methods = list(dict.fromkeys(record.method for record in records))
    swept = records[0].swept
    cases = grouped(records, lambda record: record.case)
    lines = []
    for thing, names in grouped(errors, _thing).items():
        lines += [f"{thing}: {', '.join(name.removeprefix(f'{thing} ') for name in names)}", ""]
        lines += ["| " + " | ".join([*swept, *methods]) + " |", "|---|" + "---|" * (len(swept) + len(methods) - 1)]
        for part in cases.values():
            cells = [str(part[0].params[name]) for name in swept]
            by_method = {record.method: record for record in part}
            best = min(round(as_error(names[0], record.errors[names[0]])[1], 3) for record in part)
            for method in methods:
                if method not in by_method:
                    cells.append("-")
                    continue
                figures = by_method[method].errors
                text = " / ".join(f"{figures[name]:.3g}" for name in names)
                wins = round(as_error(names[0], figures[names[0]])[1], 3) <= best
                cells.append(f"**{text}**" if wins else text)
            lines.append("| " + " | ".join(cells) + " |")
        lines.append("")
    return lines + _where_ours_loses(cases, errors) + _times(cases, methods)


def _thing(name: str) -> str:
    """What a figure is about."""
    match = THING.match(name)
    return match.group(1) if match else name


def _where_ours_loses(cases: dict[str, list[BenchmarkRecord]], errors: Sequence[str]) -> list[str]:
    """Every figure in which a peer is better by more than the margin."""
    count, lost = 0, []
    for case, part in cases.items():
        for name in errors:
            reached = {
                record.method: as_error(name, record.errors[name])[1] for record in part if name in record.errors
            }
            own = reached.pop("heartcase", None)
            if own is None or not reached:
                continue
            best = min(reached, key=reached.__getitem__)
            count += 1
            if own > reached[best] + (DICE_MARGIN if name.endswith("Dice [1]") else DISTANCE_MARGIN_MM):
                lost.append(f"| {case} | {as_error(name, own)[0]} | {own:.3g} | {reached[best]:.3g} | {best} |")
    if not count:
        return []
    lines = [
        f"Of {count} figures heartcase is the best, or within {DICE_MARGIN:g} of Dice and {DISTANCE_MARGIN_MM:g} mm of "
        f"it, in {count - len(lost)}."
    ]
    if lost:
        lines += ["Not in these:", "", "| case | error | heartcase | best | by |", "|---|---|---|---|---|", *lost]
    return [*lines, ""]


def _times(cases: dict[str, list[BenchmarkRecord]], methods: Sequence[str]) -> list[str]:
    """Median over the cases of each method's time and of its ratio to ours."""
    lines = ["| | " + " | ".join(methods) + " |", "|---|" + "---|" * len(methods)]
    seconds, ratios = [], []
    for method in methods:
        of_method = [{record.method: record.seconds for record in part} for part in cases.values()]
        of_method = [part for part in of_method if method in part]
        both = [part[method] / part["heartcase"] for part in of_method if part.get("heartcase")]
        seconds.append(f"{statistics.median(part[method] for part in of_method):.3g}")
        ratios.append(f"{statistics.median(both):.3g}" if both else "")
    lines.append("| time of one run, median over the cases [s] | " + " | ".join(seconds) + " |")
    return [*lines, "| against heartcase in the same case, median | " + " | ".join(ratios) + " |", ""]
