"""Small cases with a surface, something to teach, landmarks and a vessel."""

from __future__ import annotations

import json
import shutil

from tests.cli.small_case import write_case

LINE = [[12.0, 0.0, 0.0], [8.0, 9.0, 2.0], [0.0, 12.0, 4.0]]
LANDMARKS = [
    {"name": "right coronary artery", "kind": "polyline", "points_mm": LINE, "radius_mm": 1.5},
    {"name": "great cardiac vein", "kind": "polyline", "points_mm": LINE, "radius_mm": 1.0},
    {"name": "atriotomy", "kind": "polyline", "points_mm": LINE, "depth_mm": 3.0},
    {"name": "mid muscular defect", "kind": "ring", "points_mm": [[0, 0, 0]], "axis": [0, 0, 1], "radius_mm": 6},
    {"name": "apex", "kind": "point", "points_mm": [[20, -20, -30]]},
]


def about(title="A heart", **changes):
    return {
        "origin": "synthetic",
        "licence": "CC0-1.0",
        "attribution": "Nobody",
        "diagnoses": [{"name": "Ventricular septal defect"}],
        "texts": {"en": {"title": title, "what": "What it is.", "look_for": "The septum."}},
        **changes,
    }


def write_cases(folder, names, **manifest):
    """A folder of cases that differ in their names, and in what their manifests say."""
    toy, _ = write_case(folder, with_level=True, with_map=True)
    data = json.loads((toy / "case.json").read_text())
    for name in names:
        case = folder / f"{name}.case"
        shutil.copytree(toy, case)
        own = {"name": name, "landmarks": LANDMARKS, "about": about(f"Heart {name}")} | manifest
        (case / "case.json").write_text(json.dumps(data | own))
    shutil.rmtree(toy)
    return [folder / f"{name}.case" for name in names]
