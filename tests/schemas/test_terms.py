"""The vocabulary, against the code tables of the standard, and how names find labels."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from pydicom.sr import codedict

from heartcase.schemas.labels import Label, LabelTable, Role, default_label_table
from heartcase.schemas.recipe.recipe import parse_recipe
from heartcase.schemas.terms import CONVENTIONS, TERMS, as_markdown, normalised, term_by_code, term_by_name

TABLE = default_label_table()
DICOM_TERMS = [term for term in TERMS if term.source.startswith("DICOM")]


@pytest.mark.parametrize("term", DICOM_TERMS, ids=lambda term: term.name)
def test_codes_are_those_of_the_context_group(term):
    """pydicom carries the context groups of PS3.16: an independent copy of the table that the term names."""
    group = codedict.Collection(f"CID{term.source.rpartition(' ')[2]}")
    found = [code for code in group.concepts.values() if code.value == term.code]
    assert [(code.scheme_designator, code.meaning) for code in found] == [("SCT", term.meaning)]


def test_only_codes_with_a_source_are_there():
    assert {term.source for term in TERMS if term.code and term not in DICOM_TERMS} == {"TotalSegmentator"}
    assert all(bool(term.code) == bool(term.source) == bool(term.meaning) for term in TERMS)


def test_no_name_stands_for_two_structures():
    names = [normalised(name) for term in TERMS for name in {term.name, *term.synonyms}]
    assert len(set(names)) == len(names)
    codes = [term.code for term in TERMS if term.code]
    assert len(set(codes)) == len(codes)


@given(term=st.sampled_from(TERMS), data=st.data())
def test_case_spaces_underscores_and_hyphens_do_not_count(term, data):
    name = data.draw(st.sampled_from((term.name, *term.synonyms)))
    spelt = "".join(
        data.draw(st.sampled_from(" _-")) if c == " " else data.draw(st.sampled_from((c, c.upper()))) for c in name
    )
    assert term_by_name(spelt) is term


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(
            ("heart_ventricle_left", 1),
            ("heart_ventricle_right", 2),
            ("heart_atrium_left", 3),
            ("heart_atrium_right", 4),
        ),
        *(("aorta", 5), ("pulmonary_artery", 6), ("superior_vena_cava", 7), ("inferior_vena_cava", 8)),
        *(("heart_myocardium", 9), ("myocardium", 9), ("left ventricle of heart", 1), ("Right Atrium", 4)),
        *(("LV", 1), ("RV", 2), ("LA", 3), ("RA", 4), ("AO", 5), ("PA", 6), ("SVC", 7), ("IVC", 8)),
        *(("left ventricle", 1), ("left ventricular myocardium", 9), ("pulmonary_vein", None), ("spleen", None)),
        *(("heart", None), ("ventricle", None), ("wall", None), ("", None)),
    ],
)
def test_names_of_other_programs_find_the_default_labels(name, value):
    found = TABLE.find(name)
    assert (found and found.value) == value


def test_the_conventions_of_files_without_names():
    def values(key):
        return {
            value: label and label.value for value, name in CONVENTIONS[key].items() for label in [TABLE.find(name)]
        }

    assert values("hvsmr-2.0") == {n: n for n in range(1, 9)}
    assert values("totalsegmentator-heartchambers") == {1: 9, 2: 3, 3: 1, 4: 4, 5: 2, 6: 5, 7: 6}
    assert values("totalsegmentator-total-v2") == {52: 5, 53: None, 61: None, 62: 7, 63: 8}


def test_a_labels_own_name_comes_before_a_synonym_and_two_that_fit_are_none():
    own = Label(value=1, name="LV", role=Role.BLOOD)
    long = Label(value=2, name="morphologically left ventricle", role=Role.BLOOD)
    table = LabelTable(labels=(own, long))
    assert table.find("lv") == own
    assert table.find("Morphologically_Left_Ventricle") == long
    assert table.find("left ventricle of heart") is None
    with pytest.raises(KeyError):
        table["left ventricle of heart"]
    muscles = [
        Label(value=n, name=f"{side} ventricular myocardium", role=Role.MYOCARDIUM)
        for n, side in ((1, "left"), (2, "right"))
    ]
    assert LabelTable(labels=tuple(muscles)).find("myocardium") is None
    assert LabelTable(labels=tuple(muscles[1:])).find("myocardium").value == 2


def test_walls_are_found_by_any_name_of_their_cavity():
    table = TABLE.with_walls()
    assert table["right ventricle wall"].wall_of == 2
    assert table["RV_wall"].name == "morphologically right ventricle wall"
    assert table.find("LV wall") is None
    assert table.find("myocardium").value == 9


def test_codes_find_labels_and_a_code_that_contradicts_the_name_is_refused():
    swapped = LabelTable(labels=(Label(value=3, name="systemic ventricle", role=Role.BLOOD, snomed="53085002"),))
    assert swapped.find_code("53085002").value == swapped.find("RV").value == 3
    assert swapped.find_code("87878005") is swapped.find("LV") is None
    assert TABLE.find_code("74281007").value == 9
    assert TABLE.find_code("999999") is None
    with pytest.raises(ValidationError, match="has the SNOMED CT code of 'morphologically right ventricle'"):
        LabelTable(labels=(Label(value=3, name="left ventricle", role=Role.BLOOD, snomed="53085002"),))


def test_chambers_are_named_by_morphology_and_carry_their_codes():
    assert [TABLE[n].name for n in (1, 2, 3, 4)] == [
        "morphologically left ventricle",
        "morphologically right ventricle",
        "morphologically left atrium",
        "morphologically right atrium",
    ]
    for label in TABLE:
        assert label.value == 0 or term_by_code(label.snomed) is term_by_name(label.name) is label.term


def test_recipes_may_use_short_names():
    recipe = parse_recipe(
        """
heartcase_recipe = 1
name = "a"
scan.path = "s"
[materials.labels."RV wall"]
youngs_modulus_kpa = 12
[[strokes]]
label = "LV"
points_mm = [[0, 0, 0]]
[[ends]]
label = "Ao"
position_mm = [0, 0, 0]
axis = [0, 0, 1]
radius_mm = 5
"""
    )
    from heartcase.pipeline.bundle.write_bundle import resolve_materials

    table = recipe.table.with_walls()
    moduli = {one.label: one.youngs_modulus_kpa for one in resolve_materials(recipe.materials, table)}
    assert {label for label, modulus in moduli.items() if modulus == 12} == {table["right ventricle wall"].value}


def test_the_table_in_the_documents_is_current():
    page = Path(__file__).parents[2] / "docs" / "labels.md"
    assert page.read_text().endswith(f"\n{as_markdown()}"), "run: python -m heartcase.schemas.terms"
