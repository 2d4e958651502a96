import pytest
from pydantic import ValidationError

from heartcase.schemas.labels import Label, LabelTable, Role, default_label_table


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
    assert "value 1 is used by" in text
    assert "'A' is used twice" in text
    assert "only a blood or vessel_lumen label" in text


def test_an_unknown_label_is_a_key_error():
    with pytest.raises(KeyError):
        default_label_table()["spleen"]
