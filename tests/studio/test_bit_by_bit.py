"""Labels that pages are sent bit by bit: what is in sight at once, the rest when it is asked for."""

from unittest.mock import patch

import numpy as np
import pytest
import SimpleITK
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from heartcase.pipeline.data import Scan
from heartcase.pipeline.markers.session import SegmentationSession
from heartcase.pipeline.watershed import forest as forest_module
from heartcase.pipeline.watershed import voxel_labels
from heartcase.pipeline.watershed.tree import build_basin_tree
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.settings import Stroke
from heartcase.studio.messages import boxes_message
from heartcase.studio.painting.requests import SeenPlane
from heartcase.studio.painting.shown import Shown, planes_in_voxels
from tests.pipeline.markers.test_session import TABLE
from tests.studio.talking import Talker, page, studio
from tests.studio.test_painting import shown_from_scratch

WITHOUT_SHRINKING = [phase for phase in Phase if phase not in (Phase.shrink, Phase.explain)]
"""A tree of thousands of basins is written out for each example that is tried."""
SHAPE = (37, 70, 45)
SPACING = (1.0, 0.8, 1.5)
NAMES = ("background", *(label.name for label in list(TABLE)[1:4]))


def lattice():
    return Geometry(size=SHAPE[::-1], spacing_mm=SPACING, origin_mm=(-20.0, 4.0, 9.0), direction=np.eye(3).tolist())


def noise():
    values = gaussian_filter(np.random.default_rng(8).normal(size=SHAPE), 1.2)
    return Scan((100.0 * values).astype(np.float32), lattice())


@pytest.fixture(scope="module")
def trees():
    tree = SegmentationSession.of_scan(noise(), TABLE)._forest.tree
    # the same with half of it in flat minima, one of them much larger than the others
    floored = np.maximum(tree.height, np.median(tree.height))
    return tree, build_basin_tree(floored, tree.cost, tree.axis_cost)


class Seen:
    """A page that says what it looks at: it shows what its messages hold."""

    def __init__(self, session):
        self.shown, self.talker = Shown(session), Talker(None, session.labels.copy(), np.empty(0))

    def take(self, messages):
        for message in messages:
            self.talker._take(message)


def voxels_seen(planes):
    """Which voxels the pictures may show: those whose cube a plane meets, straight from that definition."""
    k, j, i = np.indices(SHAPE)
    seen = np.zeros(SHAPE, bool)
    for plane in planes:
        away = np.abs(np.tensordot(plane.normal, np.stack([i, j, k]), 1) - plane.offset)
        seen |= away <= 0.5 * np.abs(plane.normal).sum()
    return seen


numbers = st.floats(0.0, 1.0)
points = st.tuples(numbers, numbers, numbers)
normals = st.sampled_from([(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0), (0.6, 0.0, 0.8), (0.48, 0.6, 0.64)])
looks = st.tuples(st.just("look"), st.integers(0, 1), points, st.lists(normals, min_size=1, max_size=3))
strokes = st.tuples(st.just("paint"), st.sampled_from([*NAMES, None]), points, points, st.floats(0.0, 4.0))
steps = st.one_of(
    strokes,
    looks,
    st.tuples(st.sampled_from(["undo", "rest", "join", "copy", "glance"]), st.integers(0, 1)),
    strokes,
    st.just(("extend", (0.5, 0.5, 0.5))),
)


def go_on(session, pages, asking):
    """What a page that asks for the rest is sent."""
    if not session.is_dividing:
        asking.take(asking.shown.rest())
        return
    session.catch_up()
    for one in pages:
        one.shown.note(session.put_off_tiles)
    asking.take(asking.shown.in_sight())


@settings(max_examples=15, deadline=None, phases=WITHOUT_SHRINKING)
@given(
    todo=st.lists(steps, min_size=3, max_size=10),
    at_once=st.sampled_from([0, 0, 300]),
    most=st.sampled_from([0, 10**9]),
    behind=st.sampled_from([(0, 1.0), (0, 0.03), (10**9, 0.0)]),
    mended=st.sampled_from([0.005, 0.005, 0.5]),
    divided=st.sampled_from([10**9, 7, 200, 2000]),
    is_floored=st.booleans(),
    one_by_one=st.sampled_from([0, 10**9]),
)
def test_what_is_in_sight_is_always_exact_and_the_rest_in_the_end(
    trees, todo, at_once, most, behind, mended, divided, is_floored, one_by_one
):
    tree = trees[is_floored]
    geometry = lattice()

    def place(point):
        return geometry.index_to_world(np.array(point) * (np.array(SHAPE[::-1]) - 1)).tolist()

    limits = {"BEHIND_FROM": behind[0], "FEW_MARKED": behind[1], "MOST_MENDED": mended}
    limits |= {"DIVIDED_AT_ONCE": divided, "DIVIDED_IN_PAUSES": divided}
    voxel_limits = {"MOST_AT_ONCE": at_once, "MOST_LISTED": most, "MOST_ONE_BY_ONE": one_by_one}
    with patch.multiple(forest_module, **limits), patch.multiple(voxel_labels, **voxel_limits):
        session, plain = SegmentationSession(tree, geometry, TABLE), SegmentationSession(tree, geometry, TABLE)
        session.put_off()
        pages, planes = [Seen(session), Seen(session)], [(), ()]
        for what, *how in todo:
            box = None
            if what == "paint":
                label, first, last, radius = how
                stated = {"erase": True} if label is None else {"label": label}
                stroke = Stroke(radius_mm=radius, points_mm=[place(first), place(last)], **stated)
                box = session.paint(stroke)
                plain.paint(stroke)
            elif what == "extend" and plain.strokes and not plain.redo_count:
                box = session.extend([place(how[0])])
                plain.extend([place(how[0])])
            elif what == "undo" and plain.strokes:
                box = session.undo()
                plain.undo()
            elif what == "look":
                planes[how[0]] = planes_in_voxels(
                    [SeenPlane(point_mm=place(how[1]), normal=normal) for normal in how[2]], geometry
                )
                pages[how[0]].shown.look(planes[how[0]])
                pages[how[0]].take(pages[how[0]].shown.in_sight())
            elif what == "rest":
                go_on(session, pages, pages[how[0]])
            elif what == "join":
                # somebody wants everything at once
                np.testing.assert_array_equal(session.labels, plain.labels)
            elif what == "copy":
                np.testing.assert_array_equal(session.still().forest.labels, plain.labels)
            elif what == "glance":
                some = np.s_[how[0] :: 3, 1:-1:2, ::4]
                thinned = session.thinned_labels(some)
                assert session.is_dividing or np.array_equal(thinned, plain.labels[some])
            for one in pages:
                one.shown.note(session.put_off_tiles)
            for one in pages:
                if box is not None:
                    session.settle_boxes([box])
                    one.take([boxes_message([box], session.labels_so_far([box]))])
                one.take(one.shown.in_sight())
            if session.is_dividing:
                continue
            for one, looked in zip(pages, planes, strict=True):
                seen = voxels_seen(looked)
                np.testing.assert_array_equal(one.talker.labels[seen], plain.labels[seen])
            counts = np.bincount(plain.labels.ravel(), minlength=256)
            np.testing.assert_array_equal(session._forest.label_counts(), counts)
            assert session.marked_values() == set(np.unique(plain.marked).tolist()) - {255}
        for one in pages:
            while session.is_dividing:
                go_on(session, pages, one)
            for _ in range(40):
                if not one.shown.has_rest:
                    break
                one.take(one.shown.rest())
            np.testing.assert_array_equal(one.talker.labels, plain.labels)
        with patch.object(forest_module.Forest.fill_some, "__defaults__", (1000,)):
            while session.catch_up():
                pass
        assert not session.put_off_tiles.any()
        # a flat that has one label again is marked as a whole until somebody asks for more than labels
        session._forest.fill()
        np.testing.assert_array_equal(session._forest.foot_label, plain._forest.foot_label)
        np.testing.assert_array_equal(session._forest.foot_level, plain._forest.foot_level)


def write_large_recipe(folder):
    image = SimpleITK.GetImageFromArray(np.rint(noise().values).astype(np.int16))
    image.SetSpacing(SPACING)
    SimpleITK.WriteImage(image, str(folder / "scan.nii.gz"))
    path = folder / "painted.toml"
    path.write_text('heartcase_recipe = 1\nname = "painted"\n\n[scan]\npath = "scan.nii.gz"\nmodality = "MR"\n')
    return path


def test_a_flat_that_is_divided_bit_by_bit_is_told_in_the_end(tmp_path, monkeypatch):
    monkeypatch.setattr(forest_module, "DIVIDED_AT_ONCE", 50)
    monkeypatch.setattr(forest_module, "DIVIDED_IN_PAUSES", 2000)
    path = write_large_recipe(tmp_path)
    path.write_text(path.read_text() + "\n[segment]\nnoise_floor = 20.0\n")
    middle = [0.5 * n * s for n, s in zip(SHAPE[::-1], SPACING, strict=True)]
    with studio(path) as browser, page(browser) as talker:
        talker.ask(do="look", planes=[{"point_mm": middle, "normal": [0, 0, 1]}])
        divided, aorta = 0, TABLE.find("aorta").value
        for label, share in (("aorta", 0.3), ("background", 0.7)):
            assert talker.ask(do="paint", label=label, radius_mm=2.0, points_mm=[[share * m for m in middle]])["rest"]
            talker.ask(do="end")
            # volumes are told when they are known
            assert "volumes_ml" not in [one for one in talker.told if one["kind"] == "structures"][-1]
            while (answer := talker.ask(do="rest"))["rest"]:
                divided += answer["dividing"]
            exact = shown_from_scratch(path)
            np.testing.assert_array_equal(talker.labels, exact)
            (*_, told) = (one for one in talker.told if one["kind"] == "volumes")
            ml = (exact == aorta).sum() * np.prod(SPACING) / 1000.0
            assert told["volumes_ml"]["aorta"] == pytest.approx(ml, abs=1e-3)
        assert divided > 2
        assert 0 < (exact == aorta).sum() < 0.9 * exact.size
        # whoever comes meanwhile has all of it worked out, and the first page hears of that
        answer = talker.ask(do="paint", label="aorta", radius_mm=2.0, points_mm=[[0.6 * m for m in middle]])
        assert answer["dividing"]
        talker.ask(do="end")
        told = len(talker.told)
        with page(browser) as other:
            while talker.ask(do="rest")["rest"]:
                pass
            np.testing.assert_array_equal(talker.labels, other.labels)
        np.testing.assert_array_equal(talker.labels, shown_from_scratch(path))
        assert any(one["kind"] == "volumes" for one in talker.told[told:])


def test_pages_that_look_elsewhere_and_one_that_says_nothing_end_alike(tmp_path, monkeypatch):
    monkeypatch.setattr(voxel_labels, "MOST_AT_ONCE", 0)
    path = write_large_recipe(tmp_path)
    with studio(path) as browser, page(browser) as one, page(browser) as other:
        middle = [0.5 * n * s for n, s in zip(SHAPE[::-1], SPACING, strict=True)]
        low = [0.2 * m for m in middle]
        one.ask(do="look", planes=[{"point_mm": middle, "normal": [0, 0, 1]}])
        other.ask(do="look", planes=[{"point_mm": low, "normal": [0, 1, 0]}])
        assert one.ask(do="look", planes=[{"point_mm": low, "normal": [0, 0, 2]}])["kind"] == "refused"
        hidden = []
        for talker, label, at in ((one, "aorta", middle), (other, "background", low), (one, "aorta", low)):
            answer = talker.ask(do="paint", label=label, radius_mm=2.0, points_mm=[at])
            assert answer["kind"] == "done"
            hidden.append(answer["rest"])
            talker.ask(do="end")
        assert any(hidden)
        one.ask(do="undo")
        for talker in (one, other):
            while talker.ask(do="rest")["rest"]:
                pass
        with page(browser) as silent:
            np.testing.assert_array_equal(one.labels, silent.labels)
            np.testing.assert_array_equal(other.labels, silent.labels)
            assert len(np.unique(silent.labels)) == 2
            one.ask(do="redo")
            silent.ask(do="end")
            np.testing.assert_array_equal(silent.labels, shown_from_scratch(path))
