"""The check before a print, on shapes whose walls are known by formula."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from heartcase.pipeline.exports.print_check import check_for_printing
from heartcase.schemas.errors import StageError
from tests.pipeline.exports.shapes import ball, hollow_ball, model


def test_the_share_and_the_places_that_are_too_thin():
    check = check_for_printing(hollow_ball(), min_thickness_mm=2.0)
    # The ball that touches the outer sphere at an angle t from the shift, and the inner one, has the diameter
    # 2 (115 - 80 cos t) / (74 - 4 cos t): below 2 mm for cos t > 41 / 76; seen from the inner one, for cos t > 33 / 72.
    thin_mm2 = 2.0 * np.pi * (20.0**2 * (1.0 - 41.0 / 76.0) + 17.0**2 * (1.0 - 33.0 / 72.0))
    share = thin_mm2 / (4.0 * np.pi * (20.0**2 + 17.0**2))
    assert check.thin.area_fraction == pytest.approx(share, abs=0.005)
    assert check.thin.area_cm2 == pytest.approx(thin_mm2 / 100.0, rel=0.03)
    assert check.thinnest_mm == pytest.approx(1.0, abs=0.05)
    assert check.thinnest_at_mm[0] == pytest.approx(19.5, abs=0.7)
    assert np.abs(check.thinnest_at_mm[1:]).max() < 3.0
    # two patches, one on either side of the wall
    assert check.thin.largest_patch_cm2 == pytest.approx(2.0 * np.pi * 20.0**2 * (1.0 - 41.0 / 76.0) / 100.0, rel=0.03)
    assert check.thin.largest_patch_mm == pytest.approx((20.0, 0.0, 0.0), abs=2.0)
    (thin, closed) = check.warnings
    assert thin.startswith("25% of the surface (")
    assert "is thinner than 2 mm" in thin
    assert "thinnest 1.0" in thin
    assert closed.startswith("the model has 1 hollow without a way out")


def test_the_figures_of_a_wall_that_is_thick_enough():
    check = check_for_printing(hollow_ball(), min_thickness_mm=0.9)
    assert check.thin is None
    assert check.volume_ml == pytest.approx(4.0 / 3.0 * np.pi * (20.0**3 - 17.0**3) / 1000.0, rel=0.01)
    assert check.extent_mm == pytest.approx((40.0, 40.0, 40.0), abs=0.01)
    assert (check.piece_count, check.closed_hollow_count) == (1, 1)
    assert check.self_intersection_count == check.shared_edge_count == 0
    assert len(check.warnings) == 1


def test_a_face_that_was_cut_off_is_no_wall():
    whole = hollow_ball()
    inner = replace(whole, triangle_is_cut=(whole.triangle_label == 1).astype(np.uint8))
    assert check_for_printing(inner, min_thickness_mm=2.0).thin is None
    # the far half of the outside: nothing thin goes, but the area does that the share is of
    far = whole.vertices_mm[whole.triangles].mean(axis=1)[:, 0] < 0.0
    part = replace(whole, triangle_is_cut=(far & (whole.triangle_label == 0)).astype(np.uint8))
    before = check_for_printing(whole, min_thickness_mm=2.0).thin
    after = check_for_printing(part, min_thickness_mm=2.0).thin
    assert after.area_cm2 == pytest.approx(before.area_cm2, rel=1e-6)
    share = (20.0**2 + 17.0**2) / (0.5 * 20.0**2 + 17.0**2)
    assert after.area_fraction / before.area_fraction == pytest.approx(share, rel=0.01)


def test_pieces_that_cross_or_touch_are_told():
    # not mirrored in each other: edges that meet in a point do not cross
    away = np.array([15.0, 0.4, -0.3])
    crossing = check_for_printing(model(ball(10.0), ball(10.0, away)), min_thickness_mm=1.0)
    assert crossing.self_intersection_count > 50
    place = np.array(crossing.self_intersection_mm)
    assert [np.linalg.norm(place), np.linalg.norm(place - away)] == pytest.approx([10.0, 10.0], abs=0.7)
    assert "passes through itself" in crossing.warnings[0]
    assert "2 separate pieces" in crossing.warnings[-1]
    boxes = [trimesh.creation.box((10.0, 10.0, 10.0)) for _ in range(2)]
    boxes[1].apply_translation((10.0, 10.0, 0.0))
    touching = check_for_printing(model(*boxes), min_thickness_mm=1.0)
    assert touching.shared_edge_count == 1
    assert touching.self_intersection_count == 0
    assert touching.warnings[0].startswith("the model touches itself along 1 edge,")


def test_a_model_that_is_not_closed_is_refused():
    whole = hollow_ball()
    fields = ("triangles", "triangle_label", "triangle_tissue", "triangle_is_cut")
    open_model = replace(whole, **{name: getattr(whole, name)[1:] for name in fields})
    with pytest.raises(StageError, match="no triangles"):
        check_for_printing(replace(whole, **{name: getattr(whole, name)[:0] for name in fields}), min_thickness_mm=1.0)
    with pytest.raises(StageError, match="not closed at 3 edges"):
        check_for_printing(open_model, min_thickness_mm=1.0)
    one_turned = whole.triangles.copy()
    one_turned[0] = one_turned[0, ::-1]
    with pytest.raises(StageError, match="not closed at 3 edges"):
        check_for_printing(replace(whole, triangles=one_turned), min_thickness_mm=1.0)
    with pytest.raises(StageError, match="inside out"):
        check_for_printing(replace(whole, triangles=whole.triangles[:, ::-1].copy()), min_thickness_mm=1.0)
