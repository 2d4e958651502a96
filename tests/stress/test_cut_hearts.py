"""Random cuts into moving hearts: 25 scripts on a coarse one, 1,000 on those of the sample library, in parts.

``HEARTCASE_LIBRARY`` names the folder of a build of ``sample_cases``, such as ``out``; a case that is not in it is left
out. All of them, those of one heart, and ten of them:

    HEARTCASE_LIBRARY=out pytest -m slow tests/stress/test_cut_hearts.py
    HEARTCASE_LIBRARY=out pytest -m slow tests/stress/test_cut_hearts.py -k tetralogy
    HEARTCASE_LIBRARY=out pytest -m slow tests/stress/test_cut_hearts.py -k tetralogy-3
"""

from __future__ import annotations

import os
import tomllib
from pathlib import Path

import numpy as np
import pytest

from heartcase.cli.main import main
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.load import load_case
from heartcase.simulator.simulation import Simulation
from tests.stress.cut_scripts import operate, random_blade

SAMPLES = Path(__file__).parents[2] / "sample_cases"
LIBRARY = os.environ.get("HEARTCASE_LIBRARY")
COARSE = {
    "spacing_mm = [1.75, 1.75, 1.75]": "spacing_mm = [2.5, 2.5, 2.5]",
    "[about]\n": "[grid]\nnode_count = 6000\n\n[surface]\ntriangle_count = 16000\n\n[about]\n",
}
"""What makes the adult phantom's recipe one that is built in seconds."""
COARSE_SCRIPTS = 25
SCRIPTS, PARTS = 50, 5
"""Scripts of each heart, and the parts that they come in."""
TURNED_MAX = 0.05
"""Vertices of curved surfaces follow normals between nodes, which turn a little where nodes lose springs [cells]."""


def hearts():
    """Names of the sample cases whose scan the recipe makes."""
    recipes = [tomllib.loads(path.read_text()) for path in sorted(SAMPLES.glob("*.toml"))]
    return [one["name"] for one in recipes if "phantom" in one.get("scan", {})]


def place_of_cuts(rng, model, vertices):
    """A place of the surface whose tissue is free, LPS mm."""
    rest = model.rest_positions_mm()
    fixed = rest[model.node_is_fixed]
    while True:
        place = vertices[rng.integers(len(vertices))].astype(float)
        if np.linalg.norm(fixed - place, axis=1).min(initial=np.inf) > 4.0 * model.cell_mm:
            return place


def run(case, seed):
    """One script: up to four blades, of 4 to 30 mm, around one place of the heart."""
    rng = np.random.default_rng(seed)
    law = ForceLaw("element", poissons_ratio=0.45) if seed % 5 == 4 else ForceLaw()
    model = case.model.with_law(law)
    simulation = Simulation(model, surface=case.surface, tissue=case.tissue, damping_per_s=30.0)
    middle = place_of_cuts(rng, model, case.surface.rest_mm)
    half = rng.uniform(2.0, 15.0)
    blades = [random_blade(rng, middle - half, middle + half) for _ in range(rng.integers(1, 5))]
    return operate(simulation, rng, blades, hand_mm=middle, turned_max=TURNED_MAX)


def check(case, seeds):
    ends = [run(case, seed) for seed in seeds]
    assert sum(end.refused_count for end in ends) == 0
    assert max(end.cut_face_count for end in ends) > 0
    assert max(end.elastic_rise for end in ends) < 0.25
    assert max(end.mixed_rise for end in ends) < 0.5


@pytest.mark.usefixtures("plain_reports")
def test_random_cuts_into_a_coarse_heart(tmp_path):
    text = (SAMPLES / "adult_phantom.toml").read_text()
    for fine, coarse in COARSE.items():
        assert text.count(fine) == 1
        text = text.replace(fine, coarse)
    recipe = tmp_path / "recipes" / "adult_phantom.toml"
    recipe.parent.mkdir()
    recipe.write_text(text)
    assert main(["build", str(recipe), "--out", str(tmp_path)]) == 0
    case = load_case(tmp_path / "adult-phantom.case", needs=("surface", "tissue"), level=1)
    assert 4_000 < len(case.model.rest_positions_mm()) < 8_000
    check(case, range(COARSE_SCRIPTS))


@pytest.mark.slow
@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.parametrize("name", hearts())
def test_random_cuts_into_hearts(name, part):
    path = None if LIBRARY is None else Path(LIBRARY) / f"{name}.case"
    if path is None or not path.is_dir():
        pytest.skip(f"there is no {name}.case in the folder that HEARTCASE_LIBRARY names")
    case = load_case(path, needs=("surface", "tissue"), level=2)
    count = SCRIPTS // PARTS
    first = SCRIPTS * hearts().index(name) + part * count
    check(case, range(first, first + count))


def test_there_are_a_thousand_scripts():
    assert len(hearts()) * SCRIPTS == 1000
