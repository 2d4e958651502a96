"""What a person did or decided for a case, in plain words, without paths, file names or names from a file."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Any

from heartcase.pipeline.data import Scan
from heartcase.pipeline.report.plain_words import Fact, placed, setting_lines
from heartcase.pipeline.stages.resolve import SettingRules
from heartcase.pipeline.stages.table import STAGES
from heartcase.pipeline.warnings import counted
from heartcase.schemas.labels import Label, LabelTable, default_label_table
from heartcase.schemas.recipe.edit_settings import CloseDefect, Edit, KeepLargest, RemoveIslands, SeptalDefect
from heartcase.schemas.recipe.recipe import Recipe

__all__ = ["hand_work_facts", "region_words"]

_TOLD_APART = {"method", "ranges", "file", "names", "automatic", "connected", "septum", "contact", "find_ends"}


def hand_work_facts(recipe: Recipe, scan: Scan | None = None, *, rules: SettingRules | None = None) -> list[Fact]:
    """What a person did for this case.

    Parameters
    ----------
    recipe
        What was asked for, resolved or not.
    scan
        The scan as it was read: what was mended in it is told, and a setting is told where it differs from what the
        program would have chosen for this scan.
    rules
        Those of the scan, where a build has them already.

    Returns
    -------
    list of Fact
        In the order of the work: the scan and its region, what was painted or taken over, edits, vessel ends, what is
        held, landmarks; then wall thicknesses, materials and settings that differ from the usual ones.
    """
    return [
        *_scan_work(recipe, scan),
        *_painted(recipe),
        *_shaped(recipe),
        *_settings(recipe, rules or (SettingRules(scan) if scan is not None else None)),
    ]


def region_words(recipe: Recipe) -> str:
    """Which part of the scan was used."""
    if recipe.region is None:
        return "the whole scan"
    size = " x ".join(f"{edge:.0f}" for edge in recipe.region.size_mm)
    return f"a box of {size} mm around {placed(recipe.region.center_mm)}"


def _scan_work(recipe: Recipe, scan: Scan | None) -> Iterator[Fact]:
    source = recipe.scan
    if source.series is not None:
        yield Fact("Series of the scan", "chosen by hand")
    if source.trigger_time_ms is not None:
        yield Fact("Cardiac phase", f"the one nearest to {source.trigger_time_ms:g} ms after the R wave was chosen")
    if source.echo_time_ms is not None:
        yield Fact("Echo", f"the one nearest to {source.echo_time_ms:g} ms was chosen")
    if source.modality is not None:
        kind = {"CT": "CT", "MR": "MRI"}[source.modality]
        yield Fact("Kind of scan", f"{kind}, as the recipe says", "Counts only where the file does not say it.")
    for warning in scan.warnings if scan is not None else ():
        yield Fact("Scan changed before use", warning.text)
    if recipe.region is not None:
        yield Fact("Region of interest", region_words(recipe), "What lies outside was not used.")


def _painted(recipe: Recipe) -> Iterator[Fact]:
    by_label: dict[str, list[float]] = {}
    for stroke in recipe.strokes:
        length = sum(math.dist(a, b) for a, b in itertools.pairwise(stroke.points_mm))
        by_label.setdefault("markers erased" if stroke.label is None else stroke.label, []).append(length)
    for label, lengths in by_label.items():
        yield Fact(f"Painted: {label}", f"{counted(len(lengths), 'stroke')}, {sum(lengths):.0f} mm in all")
    if recipe.markers:
        yield Fact("Marker files", str(len(recipe.markers)), "Painted or placed in another program.")
    drafts = [file.core_mm for file in recipe.markers if file.core_mm is not None]
    if drafts:
        depths = ", ".join(f"{depth:g}" for depth in sorted({*drafts}))
        yield Fact("Drafts among them", f"{len(drafts)}, of which only what lies {depths} mm deep counts")
    if recipe.segment.method == "watershed" and recipe.segment.automatic:
        kinds = " and ".join(sorted({*recipe.segment.automatic}))
        yield Fact("Markers set by the program", kinds, "As the recipe asks: what is surely not heart.")
    if recipe.segment.method == "labels":
        yield Fact("Segmentation", "taken as it was given", "The outlines were not made by heartcase.")
    for wanted in recipe.segment.ranges if recipe.segment.method == "threshold" else ():
        low, high = (None if end is None else f"{end:g}" for end in (wanted.lower, wanted.upper))
        limits = f"from {low} to {high}" if low and high else f"from {low}" if low else f"up to {high}"
        yield Fact(f"Found by brightness: {wanted.label}", limits, "In the scan's own units.")


def _shaped(recipe: Recipe) -> Iterator[Fact]:
    for number, edit in enumerate(recipe.edits, start=1):
        yield Fact(f"Edit {number}", _edit_words(edit))
    found_count = 0 if recipe.lock is None else recipe.lock.found_end_count or 0
    for end in recipe.ends[: len(recipe.ends) - found_count]:
        yield Fact("Vessel cut off", f"{end.label} at {placed(end.position_mm)}")
    if recipe.walls.find_ends:
        yield Fact("Ends of vessels", "found by the program", "As the recipe asks: see the part on where vessels end.")
    for pin in recipe.pins:
        yield Fact("Held fixed by hand", f"ball of {pin.radius_mm:g} mm radius at {placed(pin.position_mm)}")
    for landmark in recipe.landmarks:
        yield Fact("Landmark", f"{landmark.name} ({landmark.kind})")


def _edit_words(edit: Edit) -> str:
    called = f"{edit.name}: " if edit.name else ""
    off = "" if edit.enabled else " (switched off: not carried out)"
    return f"{called}{_deed(edit)}{off}"


def _deed(edit: Edit) -> str:
    if isinstance(edit, SeptalDefect):
        return f"septal defect of {_size(edit)} made at {placed(edit.position_mm)}"
    if isinstance(edit, CloseDefect):
        return f"defect closed with a patch of {_size(edit)} at {placed(edit.position_mm)}"
    if isinstance(edit, KeepLargest):
        return f"only the largest piece of {edit.label} kept"
    if isinstance(edit, RemoveIslands):
        return f"pieces of {edit.label or 'all structures'} below {edit.smallest_ml:g} ml removed"
    verb = {"add": "added to", "remove": "removed from", "smooth": "smoothed", "fill": "holes filled in"}[edit.kind]
    where = f"{counted(len(edit.points_mm), 'point')} from {placed(edit.points_mm[0])}"
    return f"{verb} {edit.label}: brush of {edit.radius_mm:g} mm radius, {where}"


def _size(edit: SeptalDefect | CloseDefect) -> str:
    if edit.width_mm is None:
        return f"{edit.diameter_mm:g} mm"
    return f"{edit.diameter_mm:g} x {edit.width_mm:g} mm ({edit.shape})"


def _subjects() -> dict[str, str]:
    """Settings of the recipe that have defaults -> what they set."""
    return {stage.name: stage.subject for stage in STAGES if stage.subject}


def _untouched(recipe: Recipe, rules: SettingRules | None) -> Recipe:
    """The recipe as if nobody had set anything, with what the program chooses for this scan."""
    usual = {stage: Recipe.model_fields[stage].get_default() for stage in _subjects()}
    plain = Recipe.model_construct(**dict(recipe) | usual)
    return plain if rules is None else rules.resolve(plain)


def _settings(recipe: Recipe, rules: SettingRules | None) -> Iterator[Fact]:
    usual = default_label_table()
    varying = {recipe.table.find(one.label): one.thickness_mm for one in recipe.walls.thickness}
    for label in recipe.table:
        standard = _counterpart(label, usual)
        if label in varying:
            thinnest, thickest = (f"{number:g}" for number in (min(varying[label]), max(varying[label])))
            words = f"{thinnest} mm" if thinnest == thickest else f"{thinnest} to {thickest} mm, by place"
            yield Fact(f"Wall thickness: {label.name}", words)
        elif standard is not None and standard.wall_thickness_mm != label.wall_thickness_mm:
            meaning = f"Usual for an adult: {standard.wall_thickness_mm:g} mm."
            yield Fact(f"Wall thickness: {label.name}", f"{label.wall_thickness_mm:g} mm", meaning)
        elif standard is None and label.wall_thickness_mm > 0.0:
            yield Fact(f"Wall thickness: {label.name}", f"{label.wall_thickness_mm:g} mm")
    for names in recipe.walls.connected:
        yield Fact(f"Open to each other: {' and '.join(names)}", "no wall is grown between them", "As the recipe says.")
    for septum in recipe.walls.septum:
        pair = " and ".join(septum.between)
        yield Fact(f"Kept apart: {pair}", f"{septum.thickness_mm:g} mm", "Where their outlines touch.")
    for place in recipe.walls.contact:
        words = "an opening of the patient" if place.is_open else "wall, as a person said who looked at it"
        pair = " and ".join(place.between)
        yield Fact(f"Outlines touch: {pair}", words, f"Within {place.radius_mm:g} mm of {placed(place.position_mm)}.")
    default = type(recipe.materials)()
    materials = {"all tissue": recipe.materials} | dict(recipe.materials.labels)
    for name, one in materials.items():
        if name != "all tissue" or one.model_copy(update={"labels": {}}) != default:
            value = f"{one.youngs_modulus_kpa:g} kPa, {one.density_kg_m3:g} kg/m³"
            if one.material is not None:
                value = f"{one.material}: {value}"
            meaning = (
                f"Stiffness and density; usual: {default.youngs_modulus_kpa:g} kPa, {default.density_kg_m3:g} kg/m³."
            )
            yield Fact(f"Material: {name}", value, meaning)
    untouched = _untouched(recipe, rules)
    for stage, words in _subjects().items():
        chosen = getattr(recipe, stage)
        for field in type(chosen).model_fields:
            value, before = getattr(chosen, field), getattr(getattr(untouched, stage), field)
            if field in _TOLD_APART or value is None or value == before:
                continue
            meaning = "Instead of the program's choice." if before is None else f"Instead of {_plain(field, before)}."
            yield Fact(f"Setting for {words}", "; ".join(setting_lines({field: value})), meaning)


def _plain(field: str, value: Any) -> str:
    return setting_lines({field: value})[0].split(" = ")[-1]


def _counterpart(label: Label, table: LabelTable) -> Label | None:
    """The label of a usual heart that stands for the same structure."""
    return (table.find_code(label.snomed) if label.snomed else None) or table.find(label.name)
