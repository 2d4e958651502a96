"""What was measured as pictures: time against error, and error against the parameter of a sweep."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from benchmarks.runner.cases import BenchmarkRecord
from heartcase.schemas.files import atomic_write

__all__ = ["THING", "as_error", "drawn_errors", "grouped", "write_plots"]

Item = TypeVar("Item")
Key = TypeVar("Key")
Styles = dict[str, dict[str, Any]]
"""Method -> how its marks and lines are drawn, the same in all pictures of a run."""
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
"""Okabe and Ito's palette, which the colour-blind can tell apart; ours is the first."""
_MARKS = ("o", "s", "^", "D", "v", "P", "X")
_INK = "#282c34"
_COLUMNS = 3
THING = re.compile(r"^(blood pool|left myocardium|all labels|worst label) ")
"""What the drawn figures of a sweep are about: those of the single labels would be too many."""


def write_plots(records: Sequence[BenchmarkRecord], directory: Path) -> list[Path]:
    """Draw time against error, and for a sweep the error against its last parameter.

    Parameters
    ----------
    records
        What was measured, in one run on one machine.
    directory
        Made when it is not there.

    Returns
    -------
    list of Path
        The PNG files: ``CASE.png``, or for a sweep ``SWEEP-time.png`` and ``SWEEP-PARAMETER.png`` for each value of
        the other parameters.
    """
    written: list[Path] = []
    directory.mkdir(parents=True, exist_ok=True)
    styles = _styles({record.method for record in records})
    for title, part in grouped(records, lambda record: record.group or record.case).items():
        errors = drawn_errors(part)
        if not errors:
            continue
        if part[0].group is None:
            written.append(_save(_time_figure(title, part, errors, styles), directory / f"{title}.png"))
            continue
        last = part[0].swept[-1]
        for name, one in grouped(part, _picture_name).items():
            path = directory / f"{name}-{last}.png"
            written.append(_save(_swept_figure(name, one, errors, last, styles), path))
            written.append(_save(_time_figure(name, one, errors, styles), directory / f"{name}-time.png"))
    return written


def grouped(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """Items by their key, both in the order in which they come."""
    groups: dict[Key, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def _picture_name(record: BenchmarkRecord) -> str:
    """Name of the sweep with the values of all its parameters but the last."""
    return "-".join([str(record.group), *(f"{name}{record.params[name]}" for name in record.swept[:-1])])


def drawn_errors(records: Sequence[BenchmarkRecord]) -> list[str]:
    """Names of the figures of one case or sweep that are drawn: those of the large groups where there are such."""
    names = list(dict.fromkeys(name for record in records for name in record.errors))
    if records[0].group is not None:
        names = [name for name in names if THING.match(name)] or names
    return names


def as_error(name: str, value: float) -> tuple[str, float]:
    """Name and value of what is drawn, lower is better: an overlap becomes what is missing to one."""
    if name.endswith("Dice [1]"):
        return name.replace("Dice [1]", "1 - Dice"), 1.0 - value
    return name, value


def _styles(methods: Collection[str]) -> Styles:
    """Colour and mark of each method of a run: ours filled and on top, the others hollow and larger, so equals show."""
    styles = {}
    for n, method in enumerate(sorted(methods, key=lambda method: (method != "heartcase", method))):
        ours = method == "heartcase"
        colour = _COLOURS[n % len(_COLOURS)]
        styles[method] = {
            "color": colour,
            # another mark where the colours begin again
            "marker": _MARKS[(n + n // len(_COLOURS)) % len(_MARKS)],
            "markersize": 5.0 if ours else 9.0,
            "markerfacecolor": colour if ours else "none",
            "markeredgewidth": 1.4,
            "linewidth": 1.8 if ours else 1.2,
            "linestyle": "-" if ours else (0, (4, 2)),
            "zorder": 4 if ours else 3,
        }
    return styles


def _panels(errors: Sequence[str], title: str) -> tuple[Any, list[Any]]:
    from matplotlib.figure import Figure

    columns = min(_COLUMNS, len(errors))
    rows = math.ceil(len(errors) / columns)
    figure = Figure(
        figsize=(max(6.4, 3.7 * columns), 2.7 * rows + 1.1), dpi=110, facecolor="white", layout="constrained"
    )
    figure.suptitle(title, x=0.01, ha="left", color=_INK, fontsize=12)
    axes = list(figure.subplots(rows, columns, squeeze=False).ravel())
    for unused in axes[len(errors) :]:
        unused.set_axis_off()
    return figure, axes[: len(errors)]


def _finish(figure: Any, axes: Sequence[Any], records: Sequence[BenchmarkRecord], note: str) -> Any:
    from matplotlib.ticker import FormatStrFormatter

    handles, labels = axes[0].get_legend_handles_labels()
    for one in axes:
        one.spines[["top", "right"]].set_visible(False)
        one.grid(True, color="#e3e5e8", linewidth=0.6, zorder=0)
        one.set_axisbelow(True)
        one.tick_params(labelsize=8, colors=_INK)
        values = [value for line in one.get_lines() for value in line.get_ydata() if math.isfinite(value)]
        if values and min(values) > 0.0 and max(values) > 20.0 * min(values):
            one.set_yscale("log")
            one.yaxis.set_major_formatter(FormatStrFormatter("%g"))
        elif values:
            one.set_ylim(0.0, 1.1 * max(values) or 1.0)
    figure.legend(handles, labels, loc="outside upper right", ncols=len(handles), frameon=False, fontsize=9)
    caption = f"{note}\n{records[0].machine}, heartcase {records[0].version}"
    figure.supxlabel(caption, fontsize=8, color=_INK)
    return figure


def _time_figure(title: str, records: Sequence[BenchmarkRecord], errors: Sequence[str], styles: Styles) -> Any:
    """One panel for each error: time (logarithmic) to the right, error upwards, a mark per method."""
    from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

    low, high = (f(record.seconds for record in records) for f in (min, max))
    figure, axes = _panels(errors, title)
    for one, name in zip(axes, errors, strict=True):
        for method, style in styles.items():
            points = [record for record in records if record.method == method and name in record.errors]
            if not points:
                continue
            seconds = [record.seconds for record in points]
            drawn = [as_error(name, record.errors[name])[1] for record in points]
            one.plot(seconds, drawn, label=method, **style | {"linestyle": "none"})
        one.set_xscale("log")
        one.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 30.0 * low else (1.0,)))
        one.xaxis.set_major_formatter(FormatStrFormatter("%g"))
        one.xaxis.set_minor_formatter(NullFormatter())
        one.set_xlim(low / 2.0, high * 2.0)
        one.set_xlabel("time of one run (s)", fontsize=8, color=_INK)
        one.set_ylabel(as_error(name, 0.0)[0], fontsize=8, color=_INK)
    note = "lower left is better"
    if records[0].group is not None:
        last = records[0].swept[-1]
        note += f"; a mark for each number of {last}: {', '.join(_swept_values(records, last))}"
    return _finish(figure, axes, records, note)


def _swept_figure(
    title: str, records: Sequence[BenchmarkRecord], errors: Sequence[str], parameter: str, styles: Styles
) -> Any:
    """One panel for each error: the parameter to the right, error upwards, a curve per method."""
    figure, axes = _panels(errors, title)
    places = {value: n for n, value in enumerate(_swept_values(records, parameter))}
    for one, name in zip(axes, errors, strict=True):
        for method, style in styles.items():
            points = [record for record in records if record.method == method and name in record.errors]
            if not points:
                continue
            at = [places[str(record.params[parameter])] for record in points]
            one.plot(at, [as_error(name, record.errors[name])[1] for record in points], label=method, **style)
        one.set_xticks(list(places.values()), list(places))
        one.set_xlabel(parameter.replace("_", " "), fontsize=8, color=_INK)
        one.set_ylabel(as_error(name, 0.0)[0], fontsize=8, color=_INK)
    return _finish(figure, axes, records, f"lower is better; {parameter.replace('_', ' ')} per label")


def _swept_values(records: Sequence[BenchmarkRecord], parameter: str) -> list[str]:
    return list(dict.fromkeys(str(record.params[parameter]) for record in records))


def _save(figure: Any, path: Path) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    stream = io.BytesIO()
    FigureCanvasAgg(figure).print_png(stream, metadata={"Software": None})  # type: ignore[no-untyped-call]
    atomic_write(path, stream.getvalue())
    return path
