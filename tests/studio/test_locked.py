"""Locked structures and states of structures, through the studio's server."""

import base64
import io
import threading

import numpy as np
import pytest
import SimpleITK
from PIL import Image
from scipy.ndimage import gaussian_filter

from heartcase.pipeline.building.session_file import open_session
from heartcase.schemas.recipe.recipe import load_recipe
from heartcase.studio.painting import states
from tests.studio.talking import page, studio, write_recipe


@pytest.fixture
def recipe(tmp_path):
    return write_recipe(tmp_path)


def told(talker, kind):
    return [one for one in talker.told if one["kind"] == kind]


def test_a_lock_refuses_strokes_of_others_is_kept_and_is_no_line_of_the_recipe(recipe):
    path, middle = recipe
    with studio(path) as browser, page(browser) as talker, page(browser) as other:
        talker.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])
        talker.ask(do="end")
        before, text = talker.labels.copy(), path.read_text()
        assert talker.ask(do="lock", label="aorta", locked=True)["kind"] == "done"
        assert told(talker, "structures")[-1]["locked"] == ["aorta"]
        assert other.hear("structures")["locked"] == []
        assert path.read_text() == text
        other.ask(do="end")
        assert told(other, "structures")[-1]["locked"] == ["aorta"]
        refused = other.ask(do="paint", label="left ventricle", radius_mm=2.0, points_mm=[middle])
        assert "would change what is locked: aorta" in refused["problems"][0]["message"]
        other.ask(do="end")
        np.testing.assert_array_equal(other.labels, before)
        assert path.read_text() == text
        assert talker.ask(do="lock", label="spleen", locked=True)["problems"] == [
            {"place": "lock", "message": "there is no label 'spleen'"}
        ]
    with studio(path) as browser, page(browser) as talker:
        assert told(talker, "structures")[-1]["locked"] == ["aorta"]
        assert talker.ask(do="paint", label="left ventricle", radius_mm=2.0, points_mm=[middle])["kind"] == "refused"
        # taking back goes on in spite of it
        assert talker.ask(do="undo")["kind"] == "done"
        assert talker.ask(do="redo")["kind"] == "done"
        np.testing.assert_array_equal(talker.labels, before)
        talker.ask(do="lock", label="aorta", locked=False)
        assert talker.ask(do="paint", label="left ventricle", radius_mm=2.0, points_mm=[middle])["kind"] == "done"
        talker.ask(do="end")
    assert [stroke.label for stroke in load_recipe(path).strokes] == ["background", "aorta", "left ventricle"]
    np.testing.assert_array_equal(open_session(path, out=path.parent / "out").session.labels, talker.labels)


def test_each_structure_is_locked_by_itself_whatever_else_is_asked_meanwhile(recipe):
    path, _ = recipe
    with studio(path) as browser, page(browser) as talker, page(browser) as other:
        talker.ask(do="lock", label="aorta", locked=True)
        # a page that has not heard of it yet
        other.ask(do="lock", label="left ventricle", locked=True)
        other.ask(do="lock", label="pulmonary artery", locked=True)
        talker.ask(do="lock", label="aorta", locked=True)
        other.ask(do="lock", label="PULMONARY_ARTERY", locked=False)
        other.ask(do="lock", label="right ventricle", locked=False)
    with studio(path) as browser, page(browser) as talker:
        assert told(talker, "structures")[-1]["locked"] == ["morphologically left ventricle", "aorta"]


def test_states_are_told_when_it_is_quiet_and_no_stroke_waits_for_them(recipe, monkeypatch):
    path, middle = recipe
    with studio(path) as browser, page(browser) as talker:
        first = talker.hear("states")["states"]
        assert first["background"] == "marked"
        assert first["aorta"] == "nothing"
        talker.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])
        talker.ask(do="end")
        assert talker.hear("states")["states"]["aorta"] in ("confident", "unsure")
        # however long it takes, strokes go on meanwhile, and what is out of date is not told
        began, may_end, real = threading.Event(), threading.Event(), states.structure_states

        def slow(still):
            began.set()
            assert may_end.wait(60.0)
            return real(still)

        monkeypatch.setattr(states, "structure_states", slow)
        talker.ask(do="lock", label="aorta", locked=False)
        assert began.wait(60.0)
        talker.told.clear()
        talker.ask(do="paint", label="pulmonary artery", radius_mm=1.0, points_mm=[middle])
        talker.ask(do="end")
        may_end.set()
        assert talker.hear("states")["states"]["pulmonary artery"] != "nothing"
        assert len(told(talker, "states")) == 1


def test_a_place_that_is_right_does_not_come_again_also_after_a_restart(tmp_path):
    # rough ground: many places are in doubt
    values = gaussian_filter(np.random.default_rng(5).normal(size=(14, 16, 40)), 1.5)
    image = SimpleITK.GetImageFromArray((1e4 * values).astype(np.int16))
    image.SetSpacing((2.0, 2.0, 2.0))
    SimpleITK.WriteImage(image, str(tmp_path / "scan.nii.gz"))
    path = tmp_path / "painted.toml"
    path.write_text('heartcase_recipe = 1\nname = "rough"\n[scan]\npath = "scan.nii.gz"\nmodality = "MR"\n')
    middle, other = [10.0, 8.0, 6.0], [66.0, 24.0, 20.0]
    with studio(path) as browser, page(browser) as talker:
        talker.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])
        talker.ask(do="end")
        talker.ask(do="paint", label="background", radius_mm=1.0, points_mm=[other])
        talker.ask(do="end")
        text = path.read_text()
        found = talker.ask(do="suggest", count=20)["places"]
        assert found
        place = {key: found[0][key] for key in ("position_mm", "label", "rival")}
        assert talker.ask(do="confirm", **place)["kind"] == "done"
        left = talker.ask(do="suggest", count=20)["places"]
        assert place["position_mm"] not in [one["position_mm"] for one in left]
        assert path.read_text() == text
        said = talker.ask(do="confirm", **(place | {"label": "spleen"}))["problems"]
        assert said == [{"place": "confirm", "message": "there is no label 'spleen'"}]
    with studio(path) as browser, page(browser) as talker:
        assert talker.ask(do="suggest", count=20)["places"] == left
    # a file that is damaged is as if it were not there
    (file,) = path.parent.rglob("*.right.json")
    file.write_text('{"right": [{"position_mm": "x"}]}')
    with studio(path) as browser, page(browser) as talker:
        assert talker.ask(do="suggest", count=20)["places"] == found


def test_a_picture_of_a_place_shows_scan_and_labels_around_it(recipe):
    path, middle = recipe
    with studio(path) as browser, page(browser) as talker:
        talker.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])
        talker.ask(do="end")
        url = talker.ask(do="picture", position_mm=middle)["url"]
        picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2]))).convert("RGB")).astype(int)
        assert picture.shape == (84, 168, 3)
        red, green, blue = np.moveaxis(picture, -1, 0)
        for half in (slice(0, 84), slice(84, 168)):
            # the aorta is red, and lies in the middle of both planes
            assert (red - blue)[40:44, half].max() > 30
            assert (red - green)[40:44, half].max() > 30
        far = talker.ask(do="picture", position_mm=[1e5, 0.0, 0.0])["url"]
        assert far.startswith("data:image/png;base64,")
