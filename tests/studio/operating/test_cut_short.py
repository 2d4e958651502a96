"""A recording that was cut short is replayed, compared and saved as far as it is whole, and that is said."""

from heartcase.schemas.recording.reader import open_recording
from tests.studio.operating.performing import operator, theatre
from tests.studio.operating.short import cut_short
from tests.studio.operating.test_plans import newest, recorded  # noqa: F401
from tests.studio.operating.test_saved_page import told


def test_as_far_as_it_is_whole(recorded):  # noqa: F811
    path, _ = recorded
    short = open_recording(cut_short(path.parent / "wide.recording", path.parent / "short.recording"), partial=True)
    whole = open_recording(path.parent / "wide.recording")
    assert 0.0 < short.seconds < whole.seconds
    with theatre(path, path.parent) as (browser, opened), operator(browser, opened) as page:
        answer = page.done("recordings")
        assert {"short.recording", "wide.recording"} <= set(answer["recordings"])
        assert answer["cut_short"] == ["short.recording"]
        assert page.done("replay", name="short.recording", speed=4.0)["cut_short_s"] == short.seconds
        page.until(lambda frame: frame["mode"] == "paused" and frame["step"] == short.end_step)
        assert "cut_short_s" not in page.done("replay", name="wide.recording")
        page.done("compare", names=["short.recording", "wide.recording"])
        about = newest(page)["about"]
        assert about["short.recording"]["cut_short_s"] == short.seconds
        assert about["wide.recording"]["cut_short_s"] is None
        page.told.clear()
        page.done("save_page", names=["short.recording"])
        saved = told(page)
        assert saved["state"] == "saved", saved
        problem = saved["problems"][0]
        assert (problem["place"], problem["code"]) == ("short", "recording-cut-short")
        assert problem["values"] == {"seconds": f"{short.seconds:.1f}"}


def test_one_that_is_being_recorded_is_finished_before(recorded):  # noqa: F811
    path, _ = recorded
    with theatre(path, path.parent) as (browser, opened), operator(browser, opened) as page:
        page.done("record")
        name = page.until(lambda frame: frame["recording"] is not None)["recording"]
        assert name not in page.done("recordings")["cut_short"]
        page.until(lambda frame: frame["time_s"] > 0.2)
        assert "cut_short_s" not in page.done("replay", name=name)
        page.until(lambda frame: frame["recording"] is None and frame["mode"] == "paused")
        assert open_recording(path.parent / name).is_whole
