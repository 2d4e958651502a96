"""Shaping through the studio's server: lines of the recipe, and one history over all."""

import json
import random
import tomllib

import numpy as np
import pytest
import SimpleITK

from heartcase.schemas.recipe.recipe import parse_recipe
from tests.studio.talking import page, studio, write_recipe

END = {"label": "aorta", "position_mm": [0.0, 1.0, 2.0], "axis": [1.0, 0.0, 0.0], "radius_mm": 4.0}
DEFECT = {"kind": "septal_defect", "position_mm": [0.0, 1.0, 2.0], "diameter_mm": 5.0, "axis": [1.0, 0.0, 0.0]}
SCULPT = {"kind": "add", "label": "aorta", "radius_mm": 2.0, "points_mm": [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]}


@pytest.fixture
def recipe(tmp_path):
    return write_recipe(tmp_path)


def read(path):
    return parse_recipe(path.read_text(), needs_markers=False)


def last(talker, kind):
    return [one for one in talker.told if one["kind"] == kind][-1]


def test_what_is_done_stands_in_the_recipe_as_a_person_would_write_it(recipe):
    path, middle = recipe
    text = path.read_text()
    with studio(path) as browser, page(browser) as talker:
        stroke = {"label": "aorta", "radius_mm": 1.0, "points_mm": [middle]}
        talker.ask(do="paint", **stroke)
        talker.ask(do="end")
        painted = talker.labels.copy()
        assert talker.ask(do="add", list="ends", entries=[END])["undo_kind"] == "ends[1]"
        assert talker.ask(do="add", list="edits", entries=[DEFECT | {"name": None}])["undo_count"] == 3
        talker.ask(do="set", place=["materials", "youngs_modulus_kpa"], value=20)
        talker.ask(do="change", list="ends", number=1, was=END, entry=END | {"radius_mm": 5.5})
        assert path.read_text() == (
            text
            + '\n[[ends]]\nlabel = "aorta"\nposition_mm = [0.0, 1.0, 2.0]\naxis = [1.0, 0.0, 0.0]\nradius_mm = 5.5\n'
            + '\n[[edits]]\nkind = "septal_defect"\nposition_mm = [0.0, 1.0, 2.0]\ndiameter_mm = 5.0\n'
            + "axis = [1.0, 0.0, 0.0]\n\n[materials]\nyoungs_modulus_kpa = 20\n"
            + '\n# Painted in a session.\n[[strokes]]\nlabel = "aorta"\nradius_mm = 1.0\n'
            + f"points_mm = [{middle}]\n"
        )
        shape = last(talker, "shape")
        assert shape["lines"]["ends"] == [END | {"radius_mm": 5.5}]
        assert shape["lines"]["edits"] == [DEFECT]
        assert shape["settings"]["materials"] == {"youngs_modulus_kpa": 20.0}
        # strokes go on at the end, and every kind is taken back in its order
        talker.ask(do="paint", **stroke | {"radius_mm": 1.5})
        talker.ask(do="end")
        whole = path.read_bytes()
        kinds = [talker.ask(do="undo")["redo_kind"] for _ in range(3)]
        assert kinds == ["strokes", "ends[1]", "materials.youngs_modulus_kpa"]
        np.testing.assert_array_equal(talker.labels, painted)
    with studio(path) as browser, page(browser) as talker:
        assert (talker.opened["undo_count"], talker.opened["redo_count"]) == (3, 3)
        for _ in range(3):
            talker.ask(do="redo")
        assert path.read_bytes() == whole
        for _ in range(6):
            talker.ask(do="undo")
        assert path.read_text() == text
        # what was taken back is gone when something else is done
        assert (
            talker.ask(do="add", list="landmarks", entries=[{"name": "apex", "kind": "point", "points_mm": [middle]}])[
                "redo_count"
            ]
            == 0
        )
        assert talker.ask(do="redo")["kind"] == "refused"
        talker.ask(do="remove", list="landmarks", number=1, was=last(talker, "shape")["lines"]["landmarks"][0])
        assert path.read_text() == text


def test_a_wall_is_set_in_the_label_table_which_is_written_out_where_it_was_not(recipe):
    path, _ = recipe
    text = path.read_text()
    with studio(path) as browser, page(browser) as talker:
        facts = last(talker, "shaping_facts")
        assert facts["usual_wall_mm"]["aorta"] == 2.0
        before = read(path).table
        assert talker.ask(do="set", place=["labels", "aorta", "wall_thickness_mm"], value=1.2)["kind"] == "done"
        after = read(path).table
        assert after["aorta"].wall_thickness_mm == 1.2
        assert [one for one in after if one.name != "aorta"] == [one for one in before if one.name != "aorta"]
        assert path.read_text().startswith(text + '\n[[labels]]\nvalue = 1\nname = "morphologically left ventricle"\n')
        written = path.read_text()
        talker.ask(do="set", place=["labels", "right atrium", "wall_thickness_mm"], value=0)
        assert read(path).table["right atrium"].wall_thickness_mm == 0.0
        talker.ask(do="undo")
        assert path.read_text() == written
        walls = {one["label"]: one["wall_thickness_mm"] for one in last(talker, "shape")["walls"]}
        assert walls["aorta"] == 1.2


def test_a_structure_is_added_painted_taken_back_and_removed(recipe):
    path, middle = recipe
    text = path.read_text()
    vein = {"name": "pulmonary vein", "role": "vessel_lumen", "wall_thickness_mm": 1.5}
    with studio(path) as browser, page(browser) as talker, page(browser) as other:
        new = next(one for one in last(talker, "shaping_facts")["new_labels"] if one["name"] == "pulmonary vein")
        assert vein | {"colour": "#ebf1c7"} == new
        before = read(path).table
        assert talker.ask(do="add_label", entry=vein)["undo_kind"] == "labels.pulmonary vein"
        added = path.read_text()
        assert added.endswith(
            '\n[[labels]]\nvalue = 10\nname = "pulmonary vein"\nrole = "vessel_lumen"\nwall_thickness_mm = 1.5\n'
            'snomed = "122972007"\n'
        )
        assert list(read(path).table)[:-1] == list(before)
        (structure,) = [one for one in last(talker, "shape")["structures"] if one["name"] == "pulmonary vein"]
        assert structure["term"] == "pulmonary vein"
        row = {"value": 10, "name": "pulmonary vein", "colour": "#ebf1c7", "role": "vessel_lumen"}
        assert last(talker, "label_table")["labels"][-1] == row
        # another page is told, too
        other.ask(do="suggest")
        assert last(other, "label_table")["labels"][-1] == row
        talker.ask(do="lock", label="pulmonary vein", locked=True)
        talker.ask(do="paint", label="pulmonary vein", radius_mm=1.0, points_mm=[middle])
        talker.ask(do="end")
        assert (talker.labels == 10).any()
        assert "pulmonary vein" in last(talker, "structures")["marked"]
        # what is painted stays in the table
        (problem,) = talker.ask(do="remove_label", label="pulmonary vein")["problems"]
        assert "take its strokes back first" in problem["message"]
        talker.ask(do="undo")
        assert path.read_text() == added
        talker.ask(do="remove_label", label="pulmonary vein")
        assert read(path).table == before
        assert len(last(talker, "label_table")["labels"]) == len(before)
        assert last(talker, "structures")["locked"] == []
        assert talker.ask(do="paint", label="pulmonary vein", radius_mm=1.0, points_mm=[middle])["kind"] == "refused"
        assert talker.ask(do="undo")["redo_kind"] == "labels.pulmonary vein"
        assert path.read_text() == added
        talker.ask(do="undo")
        assert path.read_text() == text
        assert len(last(talker, "label_table")["labels"]) == len(before)
    # a structure that the vocabulary lacks; also after a restart
    with studio(path) as browser, page(browser) as talker:
        talker.ask(do="add_label", entry={"name": "conduit", "role": "device", "colour": "#00ff00"})
        talker.ask(do="paint", label="conduit", radius_mm=1.0, points_mm=[middle])
        talker.ask(do="end")
    with studio(path) as browser, page(browser) as talker:
        assert talker.opened["labels"][-1] == {"value": 10, "name": "conduit", "colour": "#00ff00", "role": "device"}
        assert (talker.labels == 10).any()


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ({"name": "Aorta", "role": "wall"}, "the recipe has it already, as 'aorta'"),
        ({"name": "LV", "role": "blood"}, "as 'morphologically left ventricle'"),
        ({"name": "water", "role": "background"}, "there is one background"),
        ({"name": "water", "role": "sea"}, "role"),
        ({"name": "", "role": "blood"}, "name"),
        ({"role": "blood"}, "name"),
        ({"name": "water", "role": "blood", "value": 3}, "not set on this page"),
        ({"name": "water", "role": "device", "wall_thickness_mm": 2}, "only a blood or vessel_lumen label can grow"),
        ({"name": "aorta wall", "role": "wall"}, "'aorta wall' is a label of its own"),
    ],
)
def test_a_structure_that_cannot_be_added_changes_nothing(recipe, entry, said):
    path, _ = recipe
    text = path.read_bytes()
    with studio(path) as browser, page(browser) as talker:
        answer = talker.ask(do="add_label", entry=entry)
        assert answer["kind"] == "refused"
        assert said in json.dumps(answer["problems"])
        assert path.read_bytes() == text


def test_what_the_recipe_names_cannot_be_removed(recipe):
    path, _ = recipe
    with studio(path) as browser, page(browser) as talker:
        talker.ask(do="add", list="ends", entries=[END])
        text = path.read_bytes()
        for name, said in (("aorta", "aorta"), ("background", "background"), ("nothing", "no label")):
            answer = talker.ask(do="remove_label", label=name)
            assert answer["kind"] == "refused"
            assert said in json.dumps(answer["problems"])
        assert path.read_bytes() == text


def test_the_last_structure_stays(recipe):
    path, _ = recipe
    path.write_text(path.read_text() + '\n[[labels]]\nvalue = 3\nname = "aorta"\nrole = "vessel_lumen"\n')
    text = path.read_bytes()
    with studio(path) as browser, page(browser) as talker:
        (problem,) = talker.ask(do="remove_label", label="aorta")["problems"]
        assert "the last structure" in problem["message"]
        assert path.read_bytes() == text


def test_a_structure_goes_whose_name_the_recipe_says_of_something_else(recipe):
    path, _ = recipe
    path.write_text(path.read_text().replace('name = "painted"', 'name = "aorta"'))
    with studio(path) as browser, page(browser) as talker:
        assert talker.ask(do="remove_label", label="aorta")["kind"] == "done"
        talker.ask(do="add_label", entry={"name": "scan", "role": "device"})
        assert talker.ask(do="remove_label", label="scan")["kind"] == "done"
        assert "aorta" not in {one.name for one in read(path).table}


def test_of_values_there_are_250(recipe):
    path, _ = recipe
    labels = (f'\n[[labels]]\nvalue = {n}\nname = "part {n}"\nrole = "device"\n' for n in range(1, 250))
    path.write_text(path.read_text() + "".join(labels))
    text = path.read_bytes()
    vein = {"name": "vein", "role": "vessel_lumen", "wall_thickness_mm": 1.0}
    with studio(path) as browser, page(browser) as talker:
        # one for the vein, and none for its wall
        (problem,) = talker.ask(do="add_label", entry=vein)["problems"]
        assert "every label value from 1 to 250 is taken" in problem["message"]
        assert path.read_bytes() == text
        assert talker.ask(do="add_label", entry={"name": "vein", "role": "vessel_lumen"})["kind"] == "done"
        (problem,) = talker.ask(do="add_label", entry={"name": "clip", "role": "device"})["problems"]
        assert "every label value from 1 to 250 is taken" in problem["message"]


@pytest.mark.parametrize("added", ["morphologically right ventricular myocardium", "myocardium"])
def test_no_structure_is_added_by_which_a_name_means_another_one(recipe, added):
    """Of one myocardium alone "myocardium" is the name, too."""
    path, middle = recipe
    stroke = f'\n[[strokes]]\nlabel = "myocardium"\nradius_mm = 1.0\npoints_mm = [{middle}]\n'
    plain = path.read_text()
    for text in (plain + stroke, plain):
        path.write_text(text)
        with studio(path) as browser, page(browser) as talker:
            if text == plain:
                talker.ask(do="paint", label="myocardium", radius_mm=1.0, points_mm=[middle])
                talker.ask(do="end")
            before = path.read_bytes()
            (problem,) = talker.ask(do="add_label", entry={"name": added, "role": "myocardium"})["problems"]
            assert "'myocardium' in the recipe is 'morphologically left ventricular myocardium'" in problem["message"]
            assert path.read_bytes() == before


def test_what_a_marker_file_holds_stays_in_the_table(recipe):
    """Also where strokes or an eraser cover all of it."""
    path, middle = recipe
    image = SimpleITK.ReadImage(str(path.parent / "scan.nii.gz"))
    marks = SimpleITK.Cast(image, SimpleITK.sitkUInt8) * 0
    marks[5, 4, 3] = 5
    SimpleITK.WriteImage(marks, str(path.parent / "draft.nii.gz"))
    erased = f"\n[[strokes]]\nerase = true\nradius_mm = 3.0\npoints_mm = [{middle}]\n"
    path.write_text(path.read_text() + '\n[[markers]]\npath = "draft.nii.gz"\n' + erased)
    text = path.read_bytes()
    with studio(path) as browser, page(browser) as talker:
        assert "aorta" not in last(talker, "structures")["marked"]
        (problem,) = talker.ask(do="remove_label", label="aorta")["problems"]
        assert problem["place"] == "markers[1]"
        assert "with this label table draft.nii.gz cannot be read any more" in problem["message"]
        assert path.read_bytes() == text
        # what no file holds goes
        assert talker.ask(do="remove_label", label="pulmonary artery")["kind"] == "done"
    with studio(path) as browser, page(browser) as talker:
        assert len(talker.opened["labels"]) == 9


def test_locks_and_right_places_of_a_structure_that_was_removed_do_not_come_back_with_its_name(recipe):
    path, middle = recipe
    with studio(path) as browser, page(browser) as talker:
        talker.ask(do="lock", label="aorta", locked=True)
        talker.ask(do="confirm", position_mm=middle, label="aorta", rival="background")
        talker.ask(do="remove_label", label="aorta")
        talker.ask(do="undo")
        assert last(talker, "structures")["locked"] == []
    (kept,) = path.parent.rglob("*.right.json")
    assert json.loads(kept.read_text()) == {"right": []}
    with studio(path) as browser, page(browser) as talker:
        assert last(talker, "structures")["locked"] == []


def test_no_structure_is_added_beside_which_a_draft_or_a_stroke_would_be_read_in_another_way(recipe):
    """The one muscle is called myocardium; beside a second one nobody knows which is meant."""
    path, middle = recipe
    usual, other = path.read_text(), {"name": "morphologically right ventricular myocardium", "role": "myocardium"}
    _add_draft(path, "draft.seg.nrrd", value=1, segment="Myocardium")
    with studio(path) as browser, page(browser) as talker:
        assert "morphologically left ventricular myocardium" in last(talker, "structures")["marked"]
        text = path.read_bytes()
        (problem,) = talker.ask(do="add_label", entry=other)["problems"]
        assert problem["place"] == "markers[1]"
        assert path.read_bytes() == text
    path.write_text(usual)
    with studio(path) as browser, page(browser) as talker:
        talker.ask(do="paint", label="myocardium", radius_mm=1.0, points_mm=[middle])
        talker.ask(do="end")
        (problem,) = talker.ask(do="add_label", entry=other)["problems"]
        assert problem["place"] == "labels"
        talker.ask(do="undo")
        assert talker.ask(do="add_label", entry=other)["kind"] == "done"


def _add_draft(path, name, *, value, segment=None):
    """A draft beside the recipe with one voxel in its middle, named in the recipe."""
    scan = SimpleITK.ReadImage(str(path.parent / "scan.nii.gz"))
    labels = np.zeros(scan.GetSize()[::-1], np.uint8)
    labels[3, 4, 5] = value
    image = SimpleITK.GetImageFromArray(labels)
    image.CopyInformation(scan)
    if segment is not None:
        said = {"Name": segment, "ID": "S1", "LabelValue": str(value), "Layer": "0"}
        for key, one in said.items():
            image.SetMetaData(f"Segment0_{key}", one)
    SimpleITK.WriteImage(image, str(path.parent / name))
    path.write_text(f'{path.read_text()}\n[[markers]]\npath = "{name}"\n')


def test_edits_of_bare_structures_stand_before_those_that_are_laid_over_them(recipe):
    path, _ = recipe
    with studio(path) as browser, page(browser) as talker:
        talker.ask(do="add", list="edits", entries=[SCULPT])
        smooth = SCULPT | {"kind": "smooth"}
        # a build refuses to smooth behind what was added to the same structure
        assert talker.ask(do="add", list="edits", entries=[smooth])["undo_kind"] == "edits[1]"
        assert talker.ask(do="add", list="edits", entries=[{"kind": "remove_islands"}])["undo_kind"] == "edits[2]"
        assert talker.ask(do="add", list="edits", entries=[DEFECT])["undo_kind"] == "edits[4]"
        kinds = [edit.kind for edit in read(path).edits]
        assert kinds == ["smooth", "remove_islands", "add", "septal_defect"]


def test_found_ends_and_other_ends_go_together(recipe):
    path, _ = recipe
    path.write_text(path.read_text().replace("\n[scan]", '\nends = "automatic"\n\n[scan]', 1))
    text = path.read_text()
    with studio(path) as browser, page(browser) as talker:
        talker.ask(do="add", list="ends", entries=[END, END | {"label": "pulmonary artery"}])
        assert len(read(path).ends) == 2
        assert read(path).walls.find_ends
        talker.ask(do="undo")
        assert path.read_text() == text
        talker.ask(do="set", place=["walls", "find_ends"], value=False)
        assert not read(path).walls.find_ends


WRONG = [
    ({"do": "add", "list": "ends", "entries": [END | {"radius_mm": -1}]}, "ends[1].radius_mm"),
    ({"do": "add", "list": "ends", "entries": [END | {"label": "spleen"}]}, "ends[1]"),
    ({"do": "add", "list": "ends", "entries": []}, "request.add.entries"),
    ({"do": "add", "list": "strokes", "entries": [END]}, "request.add.list"),
    ({"do": "add", "list": "edits", "entries": [{"kind": "dance"}]}, "edits[1].kind"),
    ({"do": "add", "list": "edits", "entries": [DEFECT | {"diameter_mm": "wide"}]}, "edits[1].diameter_mm"),
    ({"do": "add", "list": "edits", "entries": [DEFECT | {"shape": "slit"}]}, "edits[1].width_mm"),
    ({"do": "add", "list": "edits", "entries": [SCULPT | {"into": "aorta"}]}, "edits[1].into"),
    (
        {"do": "add", "list": "landmarks", "entries": [{"name": "a", "kind": "ring", "points_mm": [[0, 0, 0]]}]},
        "landmarks[1]",
    ),
    ({"do": "change", "list": "ends", "number": 1, "was": END, "entry": END}, "ends"),
    ({"do": "remove", "list": "edits", "number": 1}, "request.remove.was"),
    ({"do": "remove", "list": "edits", "number": 0, "was": DEFECT}, "request.remove.number"),
    ({"do": "set", "place": ["scan", "path"], "value": "/etc/passwd"}, "scan.path"),
    ({"do": "set", "place": ["labels", "spleen", "wall_thickness_mm"], "value": 1}, "labels.spleen.wall_thickness_mm"),
    ({"do": "set", "place": ["labels", "aorta", "wall_thickness_mm"], "value": 900}, "labels[5].wall_thickness_mm"),
    (
        {"do": "set", "place": ["labels", "background", "wall_thickness_mm"], "value": 1},
        "labels.background.wall_thickness_mm",
    ),
    ({"do": "set", "place": ["labels", "aorta", "wall_thickness_mm"], "value": "x"}, "labels.aorta.wall_thickness_mm"),
    (
        {"do": "set", "place": ["materials", "labels", "aorta wall"], "value": {"youngs_modulus_kpa": 1e9}},
        "materials.labels.aorta wall",
    ),
    ({"do": "set", "place": ["materials", "labels", "aorta"], "value": None}, "materials.labels.aorta"),
    ({"do": "set", "place": ["materials"]}, "materials"),
    ({"do": "set", "place": ["labels"]}, "labels"),
    ({"do": "set", "place": ["grid", "node_count"], "value": [1]}, "grid.node_count"),
    ({"do": "set", "place": ["grid", "node_count"], "value": 2}, "grid.node_count"),
    ({"do": "propose", "about": "septum", "position_mm": [900, 0, 0]}, "position_mm"),
    ({"do": "propose", "about": "vessel", "position_mm": [900, 0, 0]}, "position_mm"),
]


def test_every_refusal_names_place_and_cure_in_one_line_and_changes_nothing(recipe):
    path, _ = recipe
    text = path.read_text()
    with studio(path) as browser, page(browser) as talker:
        for request, place in WRONG:
            answer = talker.ask(**request)
            assert answer["kind"] == "refused", request
            assert answer["problems"][0]["place"].startswith(place), (request, answer)
            for problem in answer["problems"]:
                assert "\n" not in problem["message"]
                assert "unforeseen" not in problem["message"]
                assert len(problem["message"]) > 10
        assert talker.ask(do="undo")["kind"] == "refused"
        assert path.read_text() == text


def test_random_requests_of_all_kinds_leave_a_recipe_and_are_all_taken_back(recipe):
    path, middle = recipe
    text, drawn = path.read_text(), random.Random(0)
    with studio(path) as browser, page(browser) as talker:
        first = talker.labels.copy()
        for _ in range(60):
            point = [round(m + drawn.uniform(-6.0, 6.0), 1) for m in middle]
            lines = last(talker, "shape")["lines"]
            number, mm = drawn.randrange(1, 4), round(drawn.uniform(0.5, 6.0), 1)
            requests = [
                {"do": "paint", "label": "aorta", "radius_mm": 1, "points_mm": [point]},
                {"do": "add", "list": "ends", "entries": [END | {"position_mm": point}] * drawn.randrange(1, 3)},
                {"do": "add", "list": "edits", "entries": [drawn.choice([DEFECT, SCULPT])]},
                {
                    "do": "change",
                    "list": "edits",
                    "number": number,
                    "was": dict(enumerate(lines["edits"], start=1)).get(number, DEFECT),
                    "entry": DEFECT | {"diameter_mm": mm, "name": "a b"},
                },
                {
                    "do": "remove",
                    "list": (name := drawn.choice(["ends", "edits"])),
                    "number": number,
                    "was": dict(enumerate(lines[name], start=1)).get(number, END),
                },
                {"do": "set", "place": ["labels", "aorta", "wall_thickness_mm"], "value": drawn.choice([mm, None])},
                {"do": "set", "place": ["materials", "labels", "aorta wall"], "value": {"youngs_modulus_kpa": mm}},
                {"do": "undo"},
                {"do": "redo"},
            ]
            asked = drawn.choice(requests)
            talker.ask(do="end")
            before = path.read_text()
            answer = talker.ask(**asked)
            if answer["kind"] == "refused":
                assert "unforeseen" not in answer["problems"][0]["message"], asked
                assert path.read_text() == before
            read(path)
        while talker.ask(do="undo")["kind"] == "done":
            pass
        np.testing.assert_array_equal(talker.labels, first)
        assert path.read_text() == text


def test_a_line_is_changed_and_removed_as_it_was_shown_and_no_other_in_its_place(recipe):
    path, _ = recipe
    ends = [END | {"radius_mm": radius} for radius in (3.0, 4.0, 5.0)]
    with studio(path) as browser, page(browser) as talker, page(browser) as other:
        talker.ask(do="add", list="ends", entries=ends)
        assert talker.ask(do="remove", list="ends", number=2, was=ends[1])["kind"] == "done"
        # a second click, and another page that shows the line still
        for one in (talker, other):
            refused = one.ask(do="remove", list="ends", number=2, was=ends[1])
            assert refused["problems"] == [
                {"place": "ends[2]", "message": "it was changed or moved meanwhile: look at it again"}
            ]
        moved = ends[1] | {"position_mm": [1.0, 1.0, 1.0]}
        assert other.ask(do="change", list="ends", number=2, was=ends[1], entry=moved)["kind"] == "refused"
        assert [end.radius_mm for end in read(path).ends] == [3.0, 5.0]
        # however a page writes its numbers
        shown = json.loads(json.dumps(last(talker, "shape")["lines"]["ends"][1]).replace(".0", ""))
        assert talker.ask(do="change", list="ends", number=2, was=shown, entry=moved)["kind"] == "done"
        assert [end.radius_mm for end in read(path).ends] == [3.0, 4.0]


def test_another_programs_line_is_seen_before_anything_is_shaped(recipe):
    path, _ = recipe
    with studio(path) as browser, page(browser) as talker:
        talker.ask(do="add", list="ends", entries=[END])
        path.write_text(path.read_text() + "\n[grid]\nnode_count = 1000\n")
        changed = path.read_text()
        refused = talker.ask(do="remove", list="ends", number=1, was=END)
        assert "another program changed the recipe" in refused["problems"][0]["message"]
        assert path.read_text() == changed
        assert last(talker, "shape")["settings"]["grid"] == {"node_count": 1000}
        assert talker.ask(do="remove", list="ends", number=1, was=END)["kind"] == "done"
        assert tomllib.loads(path.read_text())["grid"] == {"node_count": 1000}


def test_the_surface_is_shown_as_it_is_now_and_what_is_wrong_with_it_is_told(recipe):
    path, middle = recipe
    with studio(path) as browser, page(browser) as talker:
        refused = talker.ask(do="preview")
        assert "nothing is segmented but background" in refused["problems"][0]["message"]
        talker.ask(do="paint", label="aorta", radius_mm=2.0, points_mm=[middle])
        talker.ask(do="end")
        answer = talker.ask(do="preview")
        assert (answer["kind"], answer["problems"]) == ("preview", [])
        surface = talker.surface
        assert surface["triangle_count"] > 100
        # positions, triangles, colours and normals
        assert surface["bytes"] == 18 * surface["vertex_count"] + 12 * surface["triangle_count"]
        talker.ask(do="add", list="edits", entries=[DEFECT])
        assert talker.ask(do="preview")["problems"][0]["place"] == "edits[1]"


def test_what_is_told_is_small_enough_and_plain(recipe):
    path, _ = recipe
    with studio(path) as browser, page(browser) as talker:
        assert len(json.dumps(last(talker, "shaping_facts"))) < 30_000
        shape = last(talker, "shape")
        assert {one["name"] for one in shape["structures"]} > {"aorta", "aorta wall"}
        assert str(path.parent) not in json.dumps(shape)


def test_a_name_a_material_and_what_a_place_is_are_lines_of_the_recipe_and_taken_back(recipe):
    path, _ = recipe
    text = path.read_text()
    place = {
        "between": ["left ventricle", "right ventricle"],
        "position_mm": [0.0, 1.0, 2.0],
        "radius_mm": 4.5,
        "is_open": True,
    }
    with studio(path) as browser, page(browser) as talker:
        assert talker.ask(do="set", place=["name"], value="a heart 2")["undo_kind"] == "name"
        assert (read(path).name, last(talker, "shape")["name"]) == ("a heart 2", "a heart 2")
        for value in ("", "../x", None, 3, "x" * 65):
            assert talker.ask(do="set", place=["name"], value=value)["kind"] == "refused"
        assert talker.ask(do="add", list="walls.contact", entries=[place])["undo_kind"] == "walls.contact[1]"
        assert last(talker, "shape")["lines"]["walls.contact"] == [place]
        assert "\n[[walls.contact]]\n" in path.read_text()
        bad = talker.ask(do="add", list="walls.contact", entries=[place | {"between": ["myocardium", "spleen"]}])
        assert bad["kind"] == "refused"
        # a material instead of numbers that were stated
        talker.ask(do="set", place=["materials", "youngs_modulus_kpa"], value=20)
        talker.ask(do="set", place=["materials", "material"], value=None)
        assert read(path).materials.youngs_modulus_kpa == 20.0
        talker.ask(do="set", place=["materials", "material"], value="infant myocardium")
        assert read(path).materials.youngs_modulus_kpa == 15.0
        assert "youngs_modulus_kpa" not in path.read_text()
        talker.ask(do="set", place=["materials", "labels", "aorta wall"], value={"material": "conduit"})
        assert 'material = "conduit"' in path.read_text()
        assert "youngs_modulus_kpa" not in path.read_text()
        assert read(path).materials.labels["aorta wall"].youngs_modulus_kpa == 900.0
        assert talker.ask(do="set", place=["materials", "material"], value="steel")["kind"] == "refused"
        while talker.ask(do="undo")["kind"] == "done":
            pass
        assert path.read_text() == text
