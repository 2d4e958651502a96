"""Figures and settings of the stages in plain words, with units, for people who did not write them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["Fact", "cardiac_phase_words", "figure_facts", "placed", "setting_lines", "smoothing_facts"]


@dataclass(frozen=True)
class Fact:
    """A name, its value as text, and what it means."""

    name: str
    """What it is."""
    value: str
    """With its unit."""
    meaning: str = ""
    """One short sentence, empty where the name says it all."""
    is_technical: bool = False
    """Whether it is of use to engineers only."""


_UNITS = {
    "_per_mm": "per mm",
    "_mm3": "mm³",
    "_mm": "mm",
    "_ml": "ml",
    "_cm2": "cm²",
    "_percent": "%",
    "_degrees": "degrees",
    "_deg": "degrees",
    "_kv": "kV",
    "_t": "T",
    "_kpa": "kPa",
    "_kg_m3": "kg/m³",
    "_ms": "ms",
    "_s": "s",
    "_cells": "cells",
    "_voxels": "voxels",
}
"""Ending of a figure's name -> its unit."""

_MEANINGS: dict[str, tuple[str, str]] = {
    "cell_mm": ("Edge of a cell", "The simulation cannot show anything finer than this."),
    "cell_count": ("Cells", "Small cubes that the tissue is divided into."),
    "node_count": ("Nodes", "Corners of the cells: the points that move in the simulation."),
    "face_count": ("Outer faces of cells", ""),
    "fixed_node_count": ("Nodes held fixed", "They stay where they are: where tissue was cut off, or pinned by hand."),
    "samples_per_cell_edge": ("Samples along a cell's edge", "How finely the filling of a cell was measured."),
    "tissue_volume_ml": ("Tissue before it was divided", ""),
    "grid_volume_ml": ("Tissue in the cells", ""),
    "volume_error_percent": ("Error of the tissue volume", "Near 0 is good."),
    "thickness_cells": ("Thickness of the tissue", "A wall thinner than one cell bends less easily than it should."),
    "hinge_groups_dropped": ("Loose slivers dropped", "Specks of tissue that hung by an edge and would have swung."),
    "hinge_cells_dropped": ("Cells of loose slivers", ""),
    "hinge_groups_joined": ("Loose parts joined", "Parts of the tissue that hung by an edge and would have swung."),
    "hinge_cells_added": ("Cells added to join loose parts", ""),
    "hinges_left": ("Parts that can swing", "Should be 0."),
    "tissue_pieces_over_a_cell": ("Pieces of tissue", "Pieces smaller than a cell are not counted."),
    "blood_pieces_over_a_cell": ("Pieces of blood", "Right and left heart are two, unless a defect joins them."),
    "leak_cells_added": ("Cells added to stop leaks", "Thin walls that the cells would have opened."),
    "break_cells_added": ("Cells added to join tissue", "Thin walls that the cells would have torn."),
    "openings_opened": ("Openings kept open", "Narrow passages that the cells would have closed."),
    "opening_cells_removed": ("Cells removed to keep openings", ""),
    "leaks_left": ("Leaks left", "Should be 0: blood spaces that should be apart touch here."),
    "openings_closed": ("Openings lost", "Should be 0: passages that are narrower than a cell."),
    "betti_tissue": ("Tissue", "Pieces, tunnels and enclosed hollows. They should not change."),
    "betti_blood": ("Blood", "Pieces, tunnels and enclosed hollows. They should not change."),
    "tissue_changes": ("Places where the tissue's shape changed", "Tunnels, hollows or pieces gained or lost."),
    "blood_changes": ("Places where the blood's shape changed", "Loops, hollows or pieces gained or lost."),
    "change_places_mm": ("Where, in LPS", ""),
    "triangle_count": ("Triangles", "Small flat pieces that make up the visible surface."),
    "full_triangle_count": ("Triangles before simplifying", ""),
    "vertex_count": ("Points of the surface", ""),
    "open_edge_count": ("Open edges", "Should be 0: the surface has no hole."),
    "non_manifold_edge_count": ("Edges of more than two triangles", "Should be 0."),
    "degenerate_triangle_count": ("Triangles without area", "Should be 0."),
    "self_intersection_count": (
        "Triangles that cross",
        "Pairs; should be 0: the surface passes through itself there, and may not cut or print cleanly.",
    ),
    "flipped_triangle_count": ("Triangles turned over", "Should be 0: they show as dark specks."),
    "care_rounds": ("Times it was simplified anew", "Because it passed through itself or was folded."),
    "component_count": ("Separate pieces", "Usually 1."),
    "dropped_shell_count": ("Specks left out", "Tiny pieces and bubbles that are no part of the heart."),
    "volume_ml": ("Tissue inside the surface", ""),
    "volume_change_fraction": ("Change of volume by simplifying", "Near 0 is good."),
    "distance_mean_mm": ("Distance from the full surface, mean", "How far simplifying moved the surface."),
    "distance_p99_mm": ("Distance from the full surface, 99% are below", ""),
    "distance_max_mm": ("Distance from the full surface, largest", ""),
    "other_label_count": ("Points tied to another structure", "Should be 0 or very few."),
    "inner_face_count": ("Points that follow cells around them", "In gaps and corners too narrow for a cell."),
    "curvature_share": ("Points with curvature correction", "Share of the surface that follows strong bending."),
    "offset_cells": ("Distance of the surface from the grid", ""),
}
"""Name of a figure -> what to call it, and what it means."""

_INLINE = {
    "p5": "5% below",
    "p25": "25% below",
    "p50": "median",
    "p75": "75% below",
    "p95": "95% below",
    "p99": "99% below",
    "mean": "mean",
    "min": "smallest",
    "max": "largest",
    "full_resolution": "in the scan",
    "unrepaired": "in the cells before repair",
    "grid": "in the cells",
}
"""Figures of one thing that are told in one line."""

LISTED_PLACES = 5
"""So many places are told one by one."""

_PRIVATE_SETTINGS = {"path", "file", "origin", "names", "series"}


def figure_facts(figures: Mapping[str, Any]) -> list[Fact]:
    """Turn a stage's quality figures into facts, the ones for engineers last; nested ones become one line each."""
    facts: list[Fact] = []
    for key, value in sorted(figures.items(), key=_rank):
        name, meaning = _name_of(key)
        is_technical = key not in _MEANINGS
        if not isinstance(value, Mapping):
            facts.append(Fact(name, _value_of(key, value), meaning, is_technical))
        elif value and set(value) <= set(_INLINE):
            parts = [f"{_INLINE[inner]} {_value_of(inner, figure)}" for inner, figure in value.items()]
            text = f"{', '.join(parts)} {_UNITS.get(_unit_ending(key), '')}".rstrip()
            facts.append(Fact(name, text, meaning, is_technical))
        elif set(value) & set(_MEANINGS):
            facts += figure_facts(value)
        else:
            facts += [
                Fact(f"{name}: {inner}", _value_of(key, figure), "", is_technical) for inner, figure in value.items()
            ]
    return sorted(facts, key=lambda fact: fact.is_technical)


def smoothing_facts(figures: Mapping[str, Any]) -> list[Fact]:
    """What the smoothing of the outlines did (the quality of the walls stage), narrow places first."""
    facts = [
        Fact(
            f"Narrow place, {one['label']}",
            f"{one['segmented_mm']:.1f} mm as segmented, {one['smoothed_mm']:.1f} mm as smoothed",
            f"Diameter of a circle of the same area, near {placed(one['position_mm'])}.",
        )
        for one in figures.get("narrowest_lumens", ())
    ]
    changes = figures.get("volume_change_percent", {})
    facts += [Fact(f"Volume, {name}", f"{change:+.1f} %", "", is_technical=True) for name, change in changes.items()]
    return facts


def setting_lines(settings: Mapping[str, Any]) -> list[str]:
    """A stage's settings as ``name = value`` lines; long lists are counted, paths are left out."""
    lines = []
    for key, value in settings.items():
        if key in _PRIVATE_SETTINGS or value is None:
            continue
        ending = _unit_ending(key)
        name, unit = key.removesuffix(ending).replace("_", " "), _UNITS.get(ending, "")
        if isinstance(value, Mapping):
            lines += [f"{name}: {line}" for line in setting_lines(value)]
        elif isinstance(value, Sequence) and not isinstance(value, str):
            lines.append(f"{name} = {_list_of(value)} {unit}".rstrip())
        elif isinstance(value, str) and ("/" in value or "\\" in value):
            continue
        else:
            lines.append(f"{name} = {_number(value)} {unit}".rstrip())
    return lines


def cardiac_phase_words(acquisition: Mapping[str, Any]) -> str:
    """When in the heart's cycle the scan was taken, from ``trigger_time_ms`` and ``cardiac_phase_percent``."""
    percent, time_ms = (
        float(value) if isinstance(value, int | float) and math.isfinite(value) else None
        for value in (acquisition.get("cardiac_phase_percent"), acquisition.get("trigger_time_ms"))
    )
    parts = []
    if time_ms is not None:
        parts.append(f"{time_ms:.0f} ms after the R wave")
    if percent is not None:
        parts.append(f"{percent:.0f} % of the way from one R wave to the next")
    return ", ".join(parts) or "not stated in the scan"


def placed(point: Sequence[float]) -> str:
    """A point as text, with its unit: distances to left or right, front or back, head or foot, as the studio says."""
    letters = (("L", "R"), ("P", "A"), ("H", "F"))
    parts = (f"{pair[v < 0.0]} {abs(v):.1f}" for v, pair in zip(point, letters, strict=True))
    return f"{' '.join(parts)} mm"


def _rank(item: tuple[str, Any]) -> tuple[int, str]:
    """Where a figure stands among the others, however the cache sorted them: a group stands where its first does."""
    key, value = item
    known = [key, *value] if isinstance(value, Mapping) else [key]
    order = list(_MEANINGS)
    return min((order.index(name) for name in known if name in _MEANINGS), default=len(order)), key


def _name_of(key: str) -> tuple[str, str]:
    if key in _MEANINGS:
        return _MEANINGS[key]
    ending = _unit_ending(key)
    stem = key[: -len(ending)] if ending else key
    if stem in _MEANINGS:
        return _MEANINGS[stem]
    words = stem.removesuffix("_count").replace("_", " ").strip()
    for short, long in (("p50", "(half are below)"), ("p95", "(95% are below)"), ("p99", "(99% are below)")):
        words = words.replace(short, long)
    return words[:1].upper() + words[1:], ""


def _unit_ending(key: str) -> str:
    return next((ending for ending in _UNITS if key.endswith(ending)), "")


def _value_of(key: str, value: Any) -> str:
    if isinstance(value, list | tuple) and key in ("full_resolution", "unrepaired", "grid") and len(value) == 3:
        pieces, tunnels, hollows = value
        return f"{pieces} / {tunnels} / {hollows}"
    if key.endswith(("_share", "_fraction")):
        return f"{100.0 * float(value):.3g} %"
    if isinstance(value, list | tuple) and key.endswith("places_mm"):
        more = len(value) - LISTED_PLACES
        told = ", ".join(placed(point) for point in value[:LISTED_PLACES]) or "none"
        return told + (f" and {more} more" if more > 0 else "")
    unit = _UNITS.get(_unit_ending(key), "")
    text = _list_of(value) if isinstance(value, list | tuple) else _number(value)
    return f"{text} {unit}".strip()


def _number(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        if not math.isfinite(value):
            return "not known"
        return f"{value:,.0f}" if abs(value) >= 1e4 else f"{value:.3g}"
    return str(value)


def _list_of(value: Sequence[Any]) -> str:
    if all(isinstance(item, int | float) for item in value) and len(value) <= 6:
        return ", ".join(_number(item) for item in value) or "none"
    if all(isinstance(item, str) for item in value) and len(value) <= 6:
        return ", ".join(item for item in value if "/" not in item and "\\" not in item) or "none"
    return f"{len(value)} entries"
