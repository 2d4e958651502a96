"""``heartcase info``: say what a scan, a recipe, a case or a recording is."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from heartcase.cli.shared.output import echo_json, echo_warnings, file_size, print_facts, print_table, working
from heartcase.cli.shared.stage_io import scan_options
from heartcase.pipeline.warnings import CaseWarning, counted, warnings_of
from heartcase.schemas.bundle.coordinates import WAYS
from heartcase.schemas.bundle.format import MANIFEST_NAME
from heartcase.schemas.bundle.manifest import nothing_there
from heartcase.schemas.errors import MissingPathError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recording.reader import is_recording, open_recording

if TYPE_CHECKING:
    from heartcase.pipeline.data import Scan
    from heartcase.schemas.recipe.recipe import Recipe

__all__ = ["case_facts", "command", "direction_words", "kind_of", "recipe_facts", "recording_facts", "scan_facts"]


def kind_of(path: Path) -> str:
    """Whether a path is a ``case``, a ``recipe``, a ``recording`` or (anything else that exists) a ``scan``.

    Raises
    ------
    UsageError
        There is nothing at the path.
    """
    if not path.exists():
        raise MissingPathError(nothing_there(path), place="PATH")
    if path.is_dir() and ((path / MANIFEST_NAME).exists() or path.suffix == ".case"):
        return "case"
    if is_recording(path):
        return "recording"
    return "recipe" if path.suffix.lower() == ".toml" else "scan"


@click.command()
@click.argument("path", type=click.Path(path_type=Path, readable=False))
@scan_options
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@working("reading")
def command(path: Path, as_json: bool, choice: dict[str, Any]) -> None:
    """Say what PATH is: a scan (file, or folder of DICOM files), a recipe (.toml), a case or a recording."""
    kind = kind_of(path)
    if kind == "case":
        facts = case_facts(path)
    elif kind == "recording":
        facts = recording_facts(path)
    elif kind == "recipe":
        from heartcase.schemas.recipe.recipe import load_recipe

        facts = recipe_facts(load_recipe(path), path.parent)
    else:
        facts = _scan_or_series(path, choice)
    if as_json:
        echo_json(facts)
    else:
        _SHOW[facts["kind"]](facts)


def recording_facts(path: Path) -> dict[str, Any]:
    """What was recorded, and how; of a recording that was cut short, what is whole of it."""
    recording = open_recording(path, partial=True)
    header = recording.header
    return {
        "kind": "recording",
        "is_whole": recording.is_whole,
        "case": header.case_name,
        "case_id": header.case_id,
        "seconds": recording.seconds,
        "step_count": recording.end_step - recording.start_step,
        "step_s": header.step_s,
        "node_count": header.node_count,
        "law": dict(header.law),
        "backend": header.backend,
        "command_counts": dict(Counter(entry.command.kind for entry in recording.entries[: recording.position])),
        "state_count": len(recording.states),
        "marks": [{"name": name, "step": step} for name, step in recording.marks],
        "parent": None if header.parent is None else header.parent.model_dump(),
        "log_hash": recording.log_hash,
        "software_version": header.software_version,
        "format_version": header.format_version,
    }


def scan_facts(scan: Scan) -> dict[str, Any]:
    """Size, place, orientation and intensities of a scan."""
    geometry = scan.geometry
    low, p1, median, p99, high = np.percentile(scan.values, (0, 1, 50, 99, 100))
    return {
        "kind": "scan",
        "modality": scan.modality,
        "size": list(geometry.size),
        "spacing_mm": list(geometry.spacing_mm),
        "extent_mm": [n * s for n, s in zip(geometry.size, geometry.spacing_mm, strict=True)],
        "origin_mm": list(geometry.origin_mm),
        "direction": [list(row) for row in geometry.direction],
        "axes_run_towards": direction_words(geometry),
        "oblique_degrees": _oblique_degrees(geometry),
        "is_right_handed": geometry.is_right_handed,
        "voxel_count": int(np.prod(geometry.size)),
        "intensity": {"min": low, "p1": p1, "median": median, "p99": p99, "max": high},
        "intensity_unit": "HU" if scan.modality == "CT" else "arbitrary",
        "acquisition": dict(scan.acquisition),
        "warnings": [warning.text for warning in scan.warnings],
    }


def recipe_facts(recipe: Recipe, directory: Path) -> dict[str, Any]:
    """What a recipe asks for, and its scan where that is found."""
    source = directory / recipe.scan.path
    facts: dict[str, Any] = {
        "kind": "recipe",
        "name": recipe.name,
        "method": recipe.segment.method,
        "labels": [_label_facts(label) for label in recipe.table],
        "marker_file_count": len(recipe.markers),
        "stroke_count": len(recipe.strokes),
        "edits": [edit.kind if edit.enabled else f"{edit.kind} (switched off)" for edit in recipe.edits],
        "end_marker_count": len(recipe.ends),
        "finds_ends": recipe.walls_to_grow.find_ends,
        "pin_count": len(recipe.pins),
        "landmarks": [landmark.name for landmark in recipe.landmarks],
        "parts": [part.value for part in recipe.parts],
        "scan_is_there": source.exists(),
        "scan_origin": recipe.scan.origin,
        "scan": None,
    }
    if source.exists():
        from heartcase.pipeline.formats.read_scan import read_scan

        facts["scan"] = scan_facts(read_scan(source, **recipe.scan.choice))
    return facts


def case_facts(path: Path) -> dict[str, Any]:
    """What a case says of itself: labels, volumes, counts, step sizes, files."""
    from heartcase.schemas.bundle.approval import approval_state
    from heartcase.schemas.bundle.reader import open_bundle

    manifest = open_bundle(path).manifest
    volumes = manifest.quality.get("volumes_ml", {})
    by_name = volumes if isinstance(volumes, dict) else {}
    return {
        "kind": "case",
        "name": manifest.name,
        "notice": manifest.notice,
        "approval": approval_state(path).as_dict(),
        "format_version": manifest.format_version,
        "software_version": manifest.software_version,
        "modality": manifest.modality,
        "labels": [_label_facts(label) | {"volume_ml": by_name.get(label.name)} for label in manifest.labels],
        "scan_geometry": manifest.scan_geometry,
        "simulation": manifest.simulation,
        "landmarks": [landmark.name for landmark in manifest.landmarks],
        "warnings": list(manifest.warnings),
        "warning_grades": [warning.grade for warning in warnings_of(manifest)],
        "files": [{"role": file.role.value, "name": file.name, "bytes": file.size} for file in manifest.files],
        "total_bytes": sum(file.size for file in manifest.files),
    }


def direction_words(geometry: Geometry) -> list[str]:
    """Where the axes i, j, k run to in the patient, by the nearest direction: ``left``, ``back``, ``head`` ..."""
    matrix = geometry.direction_matrix
    nearest = np.abs(matrix).argmax(axis=0)
    return [WAYS[world][int(matrix[world, axis] > 0.0)] for axis, world in enumerate(nearest)]


def _oblique_degrees(geometry: Geometry) -> float:
    """Largest angle between an axis of the scan and the nearest axis of the patient, degrees."""
    smallest = np.abs(geometry.direction_matrix).max(axis=0).min()
    return float(np.degrees(np.arccos(min(1.0, smallest))))


def _label_facts(label: Any) -> dict[str, Any]:
    return {"value": label.value, "name": label.name, "role": label.role.value, "colour": label.colour}


def _scan_or_series(path: Path, choice: dict[str, Any]) -> dict[str, Any]:
    from heartcase.pipeline.formats.read_scan import is_dicom_source, list_series, read_scan

    if is_dicom_source(path) and not {"series", "trigger_time_ms", "echo_time_ms"} & set(choice):
        found = list_series(path)
        if len(found) > 1 or found[0].has_choice:
            return {"kind": "series", "series": [_series_facts(one) for one in found]}
    return scan_facts(read_scan(path, **choice))


def _series_facts(one: Any) -> dict[str, Any]:
    from dataclasses import asdict

    return asdict(one)


def _by(values: Any, digits: int = 3) -> str:
    return " x ".join(f"{value:.{digits}g}" if isinstance(value, float) else str(value) for value in values)


def _show_scan(facts: dict[str, Any]) -> None:
    size, unit = facts["intensity"], "HU" if facts["intensity_unit"] == "HU" else "(arbitrary unit)"
    rows: list[tuple[str, object]] = [
        ("Modality", facts["modality"]),
        ("Size", f"{_by(facts['size'])} voxels ({facts['voxel_count'] / 1e6:.1f} million)"),
        ("Spacing", f"{_by(facts['spacing_mm'], 4)} mm"),
        ("Extent", f"{_by(facts['extent_mm'], 4)} mm"),
        ("Axes run towards", ", ".join(facts["axes_run_towards"])),
        ("Oblique", f"by up to {facts['oblique_degrees']:.1f} degrees" if facts["oblique_degrees"] > 0.05 else "no"),
        ("Handedness", "right-handed" if facts["is_right_handed"] else "left-handed"),
        ("First voxel at", f"({', '.join(f'{v:.1f}' for v in facts['origin_mm'])}) mm, patient LPS"),
        ("Intensity", f"{size['min']:.4g} to {size['max']:.4g} {unit}, median {size['median']:.4g}"),
        ("98% of voxels", f"{size['p1']:.4g} to {size['p99']:.4g}"),
    ]
    rows += [(name.replace("_", " ").capitalize(), value) for name, value in facts["acquisition"].items()]
    rows += [("Warning", warning) for warning in facts["warnings"]]
    print_facts(rows, title="Scan")


def _show_series(facts: dict[str, Any]) -> None:
    rows = [{**row, **{name: _times(row[name]) for name in _TIMES}} for row in facts["series"]]
    columns = [column for column in rows[0] if column not in _TIMES or any(row[column] for row in rows)]
    columns = [column for column in columns if column not in ("scanner_number", "is_phase")]
    options = ["--series"] * (len(rows) > 1) + [option for name, option in _TIMES.items() if name in columns]
    what = "several series" if len(rows) > 1 else "one series with several stacks"
    how = " and ".join(options)
    if any(row["is_phase"] for row in rows):
        what, how = "cardiac phases that are series of their own", f"{how}, or with --trigger-time MS alone"
    print_table(
        [column.replace("_", " ") for column in columns],
        [[_cell(row[column]) for column in columns] for row in rows],
        title=f"This folder holds {what}: choose one with {how}",
    )


_TIMES = {"trigger_times_ms": "--trigger-time", "echo_times_ms": "--echo-time"}


def _times(times: tuple[float, ...]) -> str:
    """Several times; one time is in the description."""
    return ", ".join(f"{time:g}" for time in times) if len(times) > 1 else ""


def _cell(value: Any) -> str:
    return _by(value) if isinstance(value, tuple | list) else "" if value is None else str(value)


def _show_recipe(facts: dict[str, Any]) -> None:
    rows: list[tuple[str, object]] = [
        ("Segmentation", facts["method"]),
        ("Labels", ", ".join(label["name"] for label in facts["labels"][1:])),
        ("Markers", f"{counted(facts['stroke_count'], 'stroke')}, {counted(facts['marker_file_count'], 'file')}"),
        ("Edits", ", ".join(kind.replace("_", " ") for kind in facts["edits"]) or "none"),
        ("Vessel ends", f"{facts['end_marker_count']}{' and those that are found' if facts['finds_ends'] else ''}"),
        ("Pins", facts["pin_count"]),
        ("Landmarks", ", ".join(facts["landmarks"]) or "none"),
        ("Parts", ", ".join(facts["parts"]) or "grid only"),
    ]
    if not facts["scan_is_there"]:
        rows.append(("Scan", "not there: put it where scan.path says"))
        if facts["scan_origin"]:
            rows.append(("Where to get it", facts["scan_origin"]))
    print_facts(rows, title=f"Recipe of {facts['name']}")
    if facts["scan"] is not None:
        click.echo()
        _show_scan(facts["scan"])


def _show_case(facts: dict[str, Any]) -> None:
    simulation, geometry = facts["simulation"], facts["scan_geometry"]
    rows: list[tuple[str, object]] = [
        ("Notice", facts["notice"]),
        ("Approval", facts["approval"]["words"]),
        ("Made by", f"heartcase {facts['software_version']}, format {facts['format_version']}"),
        ("Scan", f"{facts['modality']}, {_by(geometry.size)} voxels of {_by(geometry.spacing_mm)} mm"),
        ("Tissue", f"{simulation.tissue_volume_ml:.1f} ml"),
        ("Grid", f"{simulation.node_count:,} nodes, {simulation.cell_count:,} cells of {simulation.cell_mm:.2f} mm"),
        ("Held fixed", f"{simulation.fixed_node_count:,} nodes"),
        ("Time step", f"{1e3 * simulation.step_default_s:.3f} ms ({simulation.steps_per_second:,.0f} steps a second)"),
        ("Largest step", f"{1e3 * simulation.step_limit_s:.3f} ms (stable at rest for any lattice of such cells)"),
        ("Landmarks", ", ".join(facts["landmarks"]) or "none"),
    ]
    print_facts(rows, title=f"Case {facts['name']}")
    pairs = zip(facts["warnings"], facts["warning_grades"], strict=True)
    echo_warnings(CaseWarning(warning, grade) for warning, grade in pairs)
    volumes = [
        (label["value"], label["name"], label["role"].replace("_", " "), _volume(label["volume_ml"]))
        for label in facts["labels"]
        if label["role"] != "background"
    ]
    print_table(("value", "label", "role", "ml"), volumes, right=("value", "ml"))
    files = [(file["role"], file["name"], file_size(file["bytes"])) for file in facts["files"]]
    files.append(("all", "", file_size(facts["total_bytes"])))
    print_table(("part", "file", "size"), files, right=("size",))


def _volume(volume_ml: Any) -> str:
    return f"{volume_ml:.1f}" if isinstance(volume_ml, int | float) else "-"


def _show_recording(facts: dict[str, Any]) -> None:
    counts, parent = facts["command_counts"], facts["parent"]
    rows: list[tuple[str, object]] = [
        ("Case", (facts["case"] or "without a name") + (f" ({facts['case_id']})" if facts["case_id"] else "")),
        ("Made by", f"heartcase {facts['software_version']}, format {facts['format_version']}"),
        ("Time", f"{facts['seconds']:.3f} s, {facts['step_count']:,} steps of {1e3 * facts['step_s']:.4f} ms"),
        ("Simulated", f"{facts['node_count']:,} nodes, law {facts['law'].get('name')}, on {facts['backend']}"),
        ("Commands", ", ".join(f"{count:,} {kind.replace('_', ' ')}" for kind, count in counts.items()) or "none"),
        ("States", f"{facts['state_count']:,}"),
        *((f"Mark at step {mark['step']:,}", mark["name"]) for mark in facts["marks"]),
    ]
    if parent is not None:
        rows.append(("Branch", f"from step {parent['step']:,} of the recording {parent['log_hash'][:12]}"))
    rows.append(("Hash", facts["log_hash"][:12]))
    if not facts["is_whole"]:
        rows.append(("Warning", "it was cut short or damaged: this is what is whole of it"))
    print_facts(rows, title="Recording")


_SHOW = {
    "scan": _show_scan,
    "series": _show_series,
    "recipe": _show_recipe,
    "case": _show_case,
    "recording": _show_recording,
}
