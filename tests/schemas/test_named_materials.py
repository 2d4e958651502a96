"""Materials by name: in the schema, in the documentation, and what a recipe means by them."""

import re
from pathlib import Path
from typing import get_args

from heartcase.schemas.recipe.named_materials import MATERIALS, MaterialName
from heartcase.schemas.recipe.plausible import modulus_problem
from heartcase.schemas.recipe.recipe import parse_recipe
from heartcase.schemas.recipe.settings import MaterialSettings

RECIPE = """
heartcase_recipe = 1
name = "x"
[scan]
path = "x"
[materials]
{all}
[materials.labels.aorta]
{aorta}
"""


def of(all_tissue="", aorta=""):
    return parse_recipe(RECIPE.format(all=all_tissue, aorta=aorta), needs_markers=False).materials


def test_every_name_has_its_numbers_and_stands_in_the_documentation():
    assert set(MATERIALS) == set(get_args(MaterialName))
    text = (Path(__file__).parents[2] / "docs" / "physics.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| ([a-z ]+) \| ([\d.]+ \| [\d.]+) kPa \|$", text, re.MULTILINE))
    assert rows == {name: f"{one.ratio:g} | {one.youngs_modulus_kpa:g}" for name, one in MATERIALS.items()}
    assert not any(modulus_problem(one.youngs_modulus_kpa) for one in MATERIALS.values())


def test_the_default_is_what_it_was():
    default = MaterialSettings()
    assert (default.material, default.youngs_modulus_kpa, default.density_kg_m3) == (None, 30.0, 1060.0)
    assert MATERIALS["adult myocardium"].youngs_modulus_kpa == default.youngs_modulus_kpa


def test_a_name_states_what_is_left_out_and_numbers_beside_it_count():
    found = of('material = "infant myocardium"', 'material = "conduit"\ndensity_kg_m3 = 1400.0')
    assert (found.youngs_modulus_kpa, found.density_kg_m3) == (15.0, 1060.0)
    aorta = found.labels["aorta"]
    assert (aorta.youngs_modulus_kpa, aorta.density_kg_m3) == (900.0, 1400.0)
    # an exception without a name does not take the name of all
    assert of('material = "conduit"', "density_kg_m3 = 1100.0").labels["aorta"].youngs_modulus_kpa == 30.0
