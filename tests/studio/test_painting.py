"""Painting through the studio's server."""

import errno
import json
import time

import numpy as np
import pytest
import SimpleITK
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.pipeline.building import recipe_history
from heartcase.pipeline.building.recipe_history import RecipeHistory
from heartcase.pipeline.building.session_file import open_session
from heartcase.schemas.recipe.recipe import load_recipe
from heartcase.studio.messages import labels_message, scan_message
from heartcase.studio.painting import painting
from heartcase.studio.painting.workplace import Workplace
from tests.studio.talking import Talker, page, studio, write_recipe


@pytest.fixture
def recipe(tmp_path):
    return write_recipe(tmp_path)


def shown_from_scratch(path):
    return open_session(path, out=path.parent / "out").session.labels


def test_a_stroke_grows_is_saved_and_taken_back_after_a_restart(recipe):
    path, middle = recipe
    text = path.read_text()
    further = [middle[0] + 2.0, *middle[1:]]
    with studio(path) as browser, page(browser) as talker:
        first = talker.labels.copy()
        assert (first == 0).all()
        scan = open_session(path, out=path.parent / "out").scan
        np.testing.assert_allclose(talker.scan, scan.values, atol=np.ptp(scan.values) / 60_000)
        assert talker.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])["saved"] is False
        answer = talker.ask(do="extend", points_mm=[further])
        assert (answer["undo_count"], answer["redo_count"]) == (1, 0)
        talker.ask(do="end")
        painted = talker.labels.copy()
        assert (painted != first).any()
        # on the disk at once, in one piece
        assert load_recipe(path).strokes[-1].points_mm == (tuple(middle), tuple(further))
        np.testing.assert_array_equal(painted, shown_from_scratch(path))
        talker.ask(do="paint", label="left ventricle", radius_mm=1.0, points_mm=[further])
        talker.ask(do="end")
        talker.ask(do="undo")
        np.testing.assert_array_equal(talker.labels, painted)
    with studio(path) as browser, page(browser) as talker:
        assert (talker.opened["undo_count"], talker.opened["redo_count"]) == (1, 1)
        np.testing.assert_array_equal(talker.labels, painted)
        talker.ask(do="undo")
        np.testing.assert_array_equal(talker.labels, first)
        assert talker.ask(do="undo")["kind"] == "refused"
        assert path.read_text() == text
        talker.ask(do="redo")
        np.testing.assert_array_equal(talker.labels, painted)
        talker.ask(do="redo")
        assert talker.ask(do="redo")["kind"] == "refused"
    assert [stroke.label for stroke in load_recipe(path).strokes] == ["background", "aorta", "left ventricle"]
    assert path.read_text().startswith(text)


def test_two_pages_show_the_same_and_draw_their_own_strokes(recipe):
    path, middle = recipe
    with studio(path) as browser, page(browser) as one, page(browser) as other:
        one.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])
        refused = other.ask(do="extend", points_mm=[middle])
        (problem,) = refused["problems"]
        assert problem["place"] == "extend"
        assert problem["code"] == "nothing-to-go-on"
        assert problem["message"] == "there is no stroke to go on with: begin one"
        np.testing.assert_array_equal(one.labels, other.labels)
        # somebody else's stroke ends the first one's
        other.ask(do="paint", label="background", radius_mm=1.0, points_mm=[middle])
        assert one.ask(do="extend", points_mm=[middle])["kind"] == "refused"
        assert (one.labels == other.labels).all()
        assert [stroke.label for stroke in load_recipe(path).strokes][1:] == ["aorta"]
        other.ask(do="end")
        assert len(load_recipe(path).strokes) == 3


def test_a_stroke_under_way_is_kept_when_its_page_is_gone(recipe):
    path, middle = recipe
    with studio(path) as browser:
        with page(browser) as talker:
            talker.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])
        # the server notices in its own time
        for _ in range(100):
            if len(load_recipe(path).strokes) == 2:
                break
            time.sleep(0.1)
        assert [stroke.label for stroke in load_recipe(path).strokes][1:] == ["aorta"]
        with page(browser) as talker:
            assert talker.opened["undo_count"] == 1


@pytest.mark.parametrize("ends_with", ["page", "server"])
def test_a_stroke_that_could_not_be_saved_is_saved_when_that_goes_again(recipe, monkeypatch, ends_with):
    path, middle = recipe
    write, tries = recipe_history.atomic_write, []

    def full(file, data):
        if file == path:
            tries.append(file)
            raise OSError(errno.ENOSPC, "No space left on device")
        write(file, data)

    def until(is_there):
        for _ in range(100):
            if is_there():
                return
            time.sleep(0.1)

    with studio(path) as browser:
        with page(browser) as talker:
            monkeypatch.setattr(recipe_history, "atomic_write", full)
            talker.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])
            assert "No space left" in talker.ask(do="end")["problems"][0]["message"]
            if ends_with == "page":
                monkeypatch.setattr(recipe_history, "atomic_write", write)
        if ends_with == "page":
            until(lambda: len(load_recipe(path).strokes) == 2)
        else:
            until(lambda: len(tries) == 2)
            assert len(load_recipe(path).strokes) == 1
            monkeypatch.setattr(recipe_history, "atomic_write", write)
    assert [stroke.label for stroke in load_recipe(path).strokes] == ["background", "aorta"]


def test_a_recipe_that_another_program_changes_is_opened_again(recipe):
    path, middle = recipe
    with studio(path) as browser, page(browser) as talker:
        talker.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])
        talker.ask(do="end")
        stroke = {"label": "left ventricle", "radius_mm": 1.0, "points_mm": [[middle[0] - 3.0, *middle[1:]]]}
        path.write_text(
            path.read_text()
            + "\n# by hand\n[[strokes]]\n"
            + "".join(f"{key} = {json.dumps(value)}\n" for key, value in stroke.items())
        )
        changed = path.read_text()
        refused = talker.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])
        assert "another program changed the recipe" in refused["problems"][0]["message"]
        assert path.read_text() == changed
        np.testing.assert_array_equal(talker.labels, shown_from_scratch(path))
        # what was written by hand stays to the letter, and is not a stroke of this session
        assert [one for one in talker.told if one["kind"] == "opened"][-1]["undo_count"] == 0
        talker.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])
        talker.ask(do="end")
        assert path.read_text().startswith(changed)


@pytest.mark.parametrize(
    "act",
    [
        {"do": "end"},
        {"do": "undo"},
        {"do": "lock", "label": "aorta", "locked": True},
        {"do": "add_label", "entry": {"name": "baffle", "role": "device"}},
        {"do": "remove_label", "label": "coronary sinus"},
        {"do": "set", "place": ["name"], "value": "another"},
    ],
)
def test_every_act_on_a_recipe_that_another_program_changed_opens_it_again(recipe, act):
    path, middle = recipe
    with studio(path) as browser, page(browser) as talker, page(browser) as other:
        talker.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])
        path.write_text(path.read_text().replace('"painted"', '"changed"'))
        changed = path.read_text()
        refused = talker.ask(**act)
        (problem,) = refused["problems"]
        assert "it was opened again, and the last stroke, which was not saved yet, is lost" in problem["message"]
        opened = [one for one in talker.told if one["kind"] == "opened"][-1]
        assert (opened["name"], opened["saved"], opened["undo_count"]) == ("changed", True, 0)
        # who looks on sees the stroke go, and why
        assert other.hear("refused") == {"kind": "refused", "id": None, "problems": [problem]}
        for one in (talker, other):
            np.testing.assert_array_equal(one.labels, shown_from_scratch(path))
        assert path.read_text() == changed
        # without a stroke under way, it is opened again too, and all are told
        path.write_text(path.read_text().replace('"changed"', '"again"'))
        (problem,) = talker.ask(**act)["problems"]
        assert "it was opened again, so look before you go on" in problem["message"]
        assert other.hear("refused") == {"kind": "refused", "id": None, "problems": [problem]}
        assert talker.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])["kind"] == "done"
        assert talker.ask(do="end")["saved"]
        assert load_recipe(path).name == "again"


def test_a_recipe_that_was_changed_before_it_is_looked_at_is_read_again(recipe):
    path, middle = recipe
    with studio(path) as browser:
        with page(browser) as talker:
            talker.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])
            path.write_text(path.read_text().replace('"painted"', '"changed"'))
        # the stroke that was under way cannot be saved any more
        with page(browser) as talker:
            assert talker.opened["name"] == "changed"
            assert "is lost" in talker.hear("refused")["problems"][0]["message"]
            np.testing.assert_array_equal(talker.labels, shown_from_scratch(path))
            path.write_text(path.read_text().replace('"changed"', '"again"'))
            with page(browser) as other:
                assert other.opened["name"] == "again"
                # who loads the page sees it as it is now; who had it open is told
                other.ask(do="lock", label="aorta", locked=False)
                assert not [one for one in other.told if one["kind"] == "refused"]
            assert "so look before you go on" in talker.hear("refused")["problems"][0]["message"]
            assert [one["name"] for one in talker.told if one["kind"] == "opened"][-1] == "again"


def test_a_recipe_that_is_being_written_is_waited_for(recipe, monkeypatch):
    """An editor empties the file before it writes it."""
    path, middle = recipe
    with studio(path) as browser, page(browser) as talker:
        whole = path.read_text().replace('"painted"', '"changed"')
        path.write_text("")
        looks, look = [], Workplace._text

        def written_at_the_second_look(self):
            looks.append(path.read_text())
            if len(looks) == 2:
                path.write_text(whole)
            return look(self)

        monkeypatch.setattr(Workplace, "_text", written_at_the_second_look)
        refused = talker.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])
        assert looks == ["", "", whole, whole]
        assert "it was opened again, so look before you go on" in refused["problems"][0]["message"]
        assert [one["name"] for one in talker.told if one["kind"] == "opened"][-1] == "changed"
        assert not [one for one in talker.told if one["kind"] == "failed"]
        assert talker.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])["kind"] == "done"


def test_a_recipe_that_changes_while_it_is_opened_is_read_once_more(recipe, monkeypatch):
    """What is shown would be of the old text, and what can be taken back of the new one."""
    path, middle = recipe
    with studio(path) as browser:
        with page(browser) as talker:
            talker.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])
            talker.ask(do="end")
        whole, real = path.read_text(), painting.open_history
        without = whole.partition("# Painted in a session.")[0]

        def changed_before(path, **options):
            if path.read_text() != without:
                path.write_text(without)
            return real(path, **options)

        monkeypatch.setattr(painting, "open_history", changed_before)
        path.write_text(whole + "# by hand\n")
        with page(browser) as talker:
            assert (talker.opened["saved"], talker.opened["undo_count"]) == (True, 0)
            np.testing.assert_array_equal(talker.labels, shown_from_scratch(path))
            talker.ask(do="lock", label="aorta", locked=True)
            assert path.read_text() == without
            assert talker.ask(do="undo")["kind"] == "refused"


def test_a_recipe_that_goes_on_changing_says_so(recipe, monkeypatch):
    path, middle = recipe
    with studio(path) as browser, page(browser) as talker:
        real = painting.open_history

        def always_changed(path, **options):
            path.write_text(path.read_text() + "#\n")
            return real(path, **options)

        monkeypatch.setattr(painting, "open_history", always_changed)
        path.write_text(path.read_text() + "# by hand\n")
        talker.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])
        (failed,) = [one for one in talker.told if one["kind"] == "failed"]
        assert "another program goes on changing it" in failed["problems"][-1]["message"]


@pytest.mark.parametrize("has_stroke", [False, True])
def test_a_recipe_that_another_program_spoilt_says_so_and_is_opened_when_it_is_mended(recipe, has_stroke):
    path, middle = recipe
    with studio(path) as browser, page(browser) as talker, page(browser) as other:
        if has_stroke:
            talker.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])
        whole = path.read_text()
        path.write_text(whole.replace("scan.nii.gz", "another.nii.gz"))
        (problem,) = talker.ask(do="lock", label="aorta", locked=True)["problems"]
        assert "cannot be opened any more" in problem["message"]
        assert ("the last stroke, which was not saved yet, is lost" in problem["message"]) == has_stroke
        (failed,) = [one for one in talker.told if one["kind"] == "failed"]
        for one in (failed, other.hear("failed")):
            first, *others = one["problems"]
            assert first == problem
            assert others[0]["place"] == "scan.path"
        path.write_text(whole)
        with page(browser) as again:
            assert again.opened["name"] == "painted"
            np.testing.assert_array_equal(again.labels, shown_from_scratch(path))


def test_a_change_between_the_look_and_the_act_is_seen_too(recipe, monkeypatch):
    path, _ = recipe
    with studio(path) as browser, page(browser) as talker:
        path.write_text(path.read_text() + "# by hand\n")
        answers = iter([False])
        real = RecipeHistory.is_stale.fget
        monkeypatch.setattr(RecipeHistory, "is_stale", property(lambda self: next(answers, real(self))))
        refused = talker.ask(do="add_label", entry={"name": "baffle", "role": "device"})
        assert "it was opened again" in refused["problems"][0]["message"]
        assert talker.ask(do="add_label", entry={"name": "baffle", "role": "device"})["kind"] == "done"


def test_strokes_outside_a_region_of_interest_that_was_made_smaller_stay_and_are_taken_back(recipe):
    path, middle = recipe
    scan = SimpleITK.ReadImage(str(path.parent / "scan.nii.gz"))
    far, centre = (list(scan.TransformContinuousIndexToPhysicalPoint(one)) for one in ((6, 5, 7), (5.5, 4.5, 1.5)))
    with studio(path) as browser, page(browser) as talker:
        for label, at in (("left ventricle", middle), ("aorta", far), ("right atrium", far)):
            talker.ask(do="paint", label=label, radius_mm=1.0, points_mm=[at])
            talker.ask(do="end")
        talker.ask(do="undo")
    whole = path.read_text()
    region = f"[region]\ncenter_mm = {centre}\nsize_mm = [12.0, 15.0, 10.0]\n"
    path.write_text(whole.replace("\n[[strokes]]", f"\n{region}\n[[strokes]]", 1))
    with studio(path) as browser, page(browser) as talker:
        assert talker.labels.shape == (4, 10, 12)
        # another program changed it: what was taken back before is forgotten
        assert (talker.opened["undo_count"], talker.opened["redo_count"]) == (2, 0)
        shown = talker.labels.copy()
        np.testing.assert_array_equal(shown, shown_from_scratch(path))
        refused = talker.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[far])
        assert "lies outside the scan" in refused["problems"][0]["message"]
        talker.ask(do="undo")
        assert [stroke.label for stroke in load_recipe(path).strokes] == ["background", "left ventricle"]
        assert talker.ask(do="redo")["kind"] == "done"
        np.testing.assert_array_equal(talker.labels, shown)
        assert path.read_text().endswith(whole.split("# Painted in a session.", 1)[1])


def test_structures_places_and_what_is_missing_are_told(recipe):
    path, middle = recipe
    with studio(path) as browser, page(browser) as talker:
        talker.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])
        talker.ask(do="end")
        told = [one for one in talker.told if one["kind"] == "structures"][-1]
        session = open_session(path, out=path.parent / "out").session
        value = session.table["aorta"].value
        ml = (session.labels == value).sum() * session.geometry.voxel_volume_mm3 / 1000.0
        assert told["volumes_ml"]["aorta"] == pytest.approx(ml, abs=6e-4)
        assert told["marked"] == ["background", "aorta"]
        groups = {one["key"]: one for one in told["checklist"]}
        assert groups["background"] == {"key": "background", "done": True, "missing": []}
        assert not groups["vessels"]["done"]
        assert "aorta" not in groups["vessels"]["missing"]
        assert "pulmonary artery" in groups["vessels"]["missing"]
        places = talker.ask(do="suggest", count=2)
        assert places == {"kind": "places", "id": talker.number} | session.suggest(count=2).as_json(session.table)


def test_a_recipe_that_cannot_be_opened_says_why(recipe):
    path, _ = recipe
    path.write_text(path.read_text().replace("scan.nii.gz", "another.nii.gz"))
    with studio(path) as browser, page(browser) as talker:
        assert talker.opened["kind"] == "failed"
        assert talker.opened["problems"]
        assert talker.ask(do="undo")["kind"] == "refused"


@pytest.mark.parametrize(
    ("lowest", "highest", "is_exact"), [(-1000.0, 3000.0, True), (0.0, 65000.0, False), (5.0, 5.0, True)]
)
def test_intensities_are_told_in_16_bits(lowest, highest, is_exact, recipe):
    scan = open_session(recipe[0], out=recipe[0].parent / "out").scan
    values = np.rint(np.linspace(lowest, highest, scan.values.size)).reshape(scan.values.shape).astype(np.float32)
    message = scan_message(type(scan)(values, scan.geometry))
    length = int.from_bytes(message[:4], "little")
    header = json.loads(message[4 : 4 + length])
    numbers = np.frombuffer(message[4 + length :], "<i2").reshape(values.shape)
    error = np.abs(numbers * header["scale"] + header["offset"] - values).max()
    assert error == 0.0 if is_exact else error <= (highest - lowest) / 65534


def test_other_pages_learn_that_a_stroke_is_saved(recipe):
    path, middle = recipe
    with studio(path) as browser, page(browser) as one, page(browser) as other:
        one.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])
        assert other.hear("done")["saved"] is False
        one.ask(do="end")
        assert other.hear("done")["saved"] is True
    with studio(path) as browser, page(browser) as other:
        with page(browser) as one:
            one.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])
            assert other.hear("done")["saved"] is False
        # whoever drew it is gone
        assert other.hear("done")["saved"] is True


def test_the_checklist_asks_for_both_atria_and_for_ends(recipe):
    path, middle = recipe
    with studio(path) as browser, page(browser) as talker:

        def groups():
            told = [one for one in talker.told if one["kind"] == "structures"][-1]
            return {one["key"]: one for one in told["checklist"]}

        assert list(groups()) == ["background", "chambers", "atria", "vessels", "myocardium", "ends"]
        assert groups()["atria"]["missing"] == ["morphologically left atrium", "morphologically right atrium"]
        talker.ask(do="paint", label="left atrium", radius_mm=1.0, points_mm=[middle])
        talker.ask(do="end")
        assert groups()["atria"]["missing"] == ["morphologically right atrium"]
        assert "morphologically left atrium" not in groups()["chambers"]["missing"]
        end = {"label": "aorta", "position_mm": middle, "axis": [0.0, 0.0, 1.0], "radius_mm": 3.0}
        assert talker.ask(do="add", list="ends", entries=[end])["kind"] == "done"
        assert "aorta" not in groups()["ends"]["missing"]
        talker.ask(do="undo")
        assert "aorta" in groups()["ends"]["missing"]
        talker.ask(do="set", place=["walls", "find_ends"], value=True)
        assert groups()["ends"]["done"]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([1, 3, 40, 4000]), st.sampled_from([(40, 50, 30), (3, 5, 7)]))
def test_labels_arrive_as_they_are_however_they_are_sent(seed, most, shape):
    drawn = np.random.default_rng(seed)
    lengths = drawn.integers(1, most + 1, np.prod(shape))
    labels = np.repeat(drawn.integers(0, 256, len(lengths)).astype(np.uint8), lengths)[: np.prod(shape)].reshape(shape)
    low = drawn.integers(0, 3, 3)
    box = tuple(slice(int(first), size - 1) for first, size in zip(low, shape, strict=True))
    talker = Talker(None, labels=np.full(shape, 255, np.uint8), scan=np.zeros(shape))
    message = labels_message(labels, box)
    talker._take(message)
    np.testing.assert_array_equal(talker.labels[box], labels[box])
    # never longer than the labels themselves
    assert len(message) <= labels[box].size + 200
