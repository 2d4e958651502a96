import itertools

import numpy as np
import pytest
from pydantic import ValidationError
from skimage import color

from heartcase.schemas.labels import Label, LabelTable, Role, default_label_table
from heartcase.schemas.terms import TERMS


def test_the_default_table_has_a_heart_with_four_chambers():
    table = default_label_table()
    assert table["Left Ventricle"].value == 1
    assert table[9].role is Role.MYOCARDIUM
    assert table.tissue_values == (9,)
    assert table.blood_values == (1, 2, 3, 4, 5, 6, 7, 8)


def test_walls_are_added_once_and_typed_by_what_they_surround():
    table = default_label_table().with_walls()
    assert table.with_walls() == table
    right_ventricle, aorta = table.wall_value(2), table.wall_value(5)
    assert table[right_ventricle].role is Role.MYOCARDIUM
    assert table[aorta].role is Role.WALL
    assert table[aorta].name == "aorta wall"
    assert table.wall_value(1) is None


def test_every_problem_of_a_table_is_reported():
    with pytest.raises(ValidationError) as error:
        LabelTable(
            labels=(
                Label(value=1, name="a", role=Role.BLOOD),
                Label(value=1, name="A", role=Role.MYOCARDIUM, wall_thickness_mm=2.0),
            )
        )
    text = str(error.value)
    assert "value 1 is used by rows 1 and 2 ('a', 'A')" in text
    assert "the name 'a' is used by rows 1 and 2" in text
    assert "only a blood or vessel_lumen label" in text


def test_an_unknown_label_is_a_key_error():
    with pytest.raises(KeyError):
        default_label_table()["spleen"]


# Colour vision deficiency as matrices on linear RGB, severity 1: Machado, Oliveira and Fernandes 2009.
SIGHT = {
    "normal": np.eye(3),
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}


@pytest.mark.parametrize("sight", SIGHT)
def test_default_colours_can_be_told_apart(sight):
    """CIEDE2000 between any two structures; about 2 is just noticeable side by side."""
    # the plain myocardium looks as the left ventricle's: a table has one or the other
    terms = [term for term in TERMS if term.name != "myocardium"]
    labels = [Label(value=n, name=term.name, role=Role.BLOOD) for n, term in enumerate(terms, start=1)]
    rgb = np.array([[int(label.colour[at : at + 2], 16) / 255 for at in (1, 3, 5)] for label in labels])
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    seen = np.clip(linear @ np.array(SIGHT[sight]).T, 0.0, 1.0)
    lab = color.xyz2lab(seen @ color.colorconv.xyz_from_rgb.T)
    for one, other in itertools.combinations(range(len(labels)), 2):
        difference = color.deltaE_ciede2000(lab[one], lab[other])
        assert difference > 12.0, (labels[one].name, labels[other].name, difference)


def test_a_structure_has_its_colour_whatever_it_is_called():
    default = {label.name: label.colour for label in default_label_table()}
    for name, snomed in (("LV", None), ("heart ventricle left", None), ("systemic ventricle", "87878005")):
        assert Label(value=3, name=name, role=Role.BLOOD, snomed=snomed).colour == "#d41515"
    assert default["morphologically left ventricle"] == "#d41515"
    assert Label(value=3, name="LV", role=Role.BLOOD, colour="#00ff00").colour == "#00ff00"
    assert Label(value=3, name="cavity", role=Role.BLOOD).colour == "#a0a0a0"


def test_a_grown_wall_does_not_take_the_name_of_a_label():
    aorta = Label(value=1, name="aorta", role=Role.VESSEL_LUMEN, wall_thickness_mm=2.0)
    wall = Label(value=2, name="Aorta wall", role=Role.WALL)
    with pytest.raises(ValidationError, match="is a label of its own"):
        LabelTable(labels=(aorta, wall))
    assert len(LabelTable(labels=(aorta, wall.model_copy(update={"wall_of": 1}))).with_walls()) == 3
    assert len(LabelTable(labels=(aorta.model_copy(update={"wall_thickness_mm": 0.0}), wall)).with_walls()) == 3
