"""Strokes that are missing: found where they are, and of use by another program's geodesic distances."""

import numpy as np
import pytest
from skimage.graph import MCP_Geometric

from heartcase.phantom.drawing import corrections
from heartcase.phantom.drawing.corrections import corrective_lines, wall_lines
from heartcase.phantom.drawing.strokes import marker_strokes
from tests.phantom.conftest import lattice_points
from tests.phantom.test_strokes import segment_points

RADIUS_MM = 0.8


@pytest.fixture(scope="module")
def few(child):
    """Strokes of the child's blood: of the right atrium only the one in its appendage, of the aorta only its arch."""
    lines = [(one.label, one.radius_mm, np.array(one.points_mm)) for one in marker_strokes(child)]
    blood = [line for line in lines if child.table[line[0]].role.is_blood]
    atrium = [line for line in blood if line[0] == "right atrium"]
    aorta = [line for line in blood if line[0] == "aorta"]
    others = [line for line in blood if line[0] not in ("right atrium", "aorta")]
    top = max(atrium, key=lambda line: line[2][:, 2].mean())
    return [*others, top, max(aorta, key=lambda line: line[2][:, 2].mean())]


@pytest.fixture(scope="module")
def voxels(child):
    geometry = child.scan_geometry(1.0, margin_mm=2.0)
    points = lattice_points(geometry)
    return geometry, points, child.truth.label(points)


def lost_ml(child, voxels, lines):
    """Blood, per label, that is nearer to another cavity's strokes through blood; by scikit-image."""
    geometry, _, labels = voxels
    blood = np.isin(labels, child.truth.table.blood_values)
    names = sorted({line[0] for line in lines})
    ways = []
    for name in names:
        dense = np.concatenate([segment_points(line[2]) for line in lines if line[0] == name])
        starts = np.unique(np.round(geometry.world_to_index(dense)).astype(int)[:, ::-1], axis=0)
        starts = [tuple(start) for start in starts if blood[tuple(start)]]
        ways.append(MCP_Geometric(np.where(blood, 1.0, -1.0)).find_costs(starts)[0])
    won = np.array([child.table[name].value for name in names])[np.argmin(ways, axis=0)]
    return {name: float((blood & (labels == child.table[name].value) & (won != labels)).sum()) / 1000 for name in names}


def test_strokes_are_added_where_blood_is_lost(child, few, voxels):
    added = corrective_lines(child, few, RADIUS_MM)
    before, after = lost_ml(child, voxels, few), lost_ml(child, voxels, [*few, *added])
    assert {"right atrium", "aorta"} <= {name for name, _, _ in added}
    for name in ("right atrium", "aorta"):
        assert before[name] > 0.8
        assert after[name] < 0.25 * before[name], name
    assert sum(after.values()) < 0.4 * sum(before.values())


def test_what_is_added_stays_inside_its_cavity(child, few):
    for name, radius, line in corrective_lines(child, few, RADIUS_MM):
        assert radius == RADIUS_MM
        points = segment_points(line)
        assert (child.truth.value(points, child.table[name].value) < -RADIUS_MM).all(), name


def test_no_more_are_added_than_may_be(child, few, monkeypatch):
    monkeypatch.setattr(corrections, "MOST_IN_BLOOD", 3)
    added = corrective_lines(child, few, RADIUS_MM)
    assert len(added) == 3
    # The first are those where most is lost.
    assert {name for name, _, _ in added} & {"right atrium", "aorta"}


def test_a_heart_whose_strokes_fill_it_needs_none(child, monkeypatch):
    points = lattice_points(child.scan_geometry(2.0, margin_mm=2.0)).reshape(-1, 3)
    labels = child.truth.label(points)
    blood = sorted({one.label for one in marker_strokes(child) if child.table[one.label].role.is_blood})
    full = [(name, 0.5, points[labels == child.table[name].value]) for name in blood]
    monkeypatch.setattr(corrections, "_dense", lambda line: line)
    assert corrective_lines(child, full, RADIUS_MM) == []


def test_lines_in_walls_stay_in_them_and_part_them_from_muscle(child):
    drawn = [(one.label, one.radius_mm, np.array(one.points_mm)) for one in marker_strokes(child)]
    found = wall_lines(child, drawn)
    assert {name for name, _, _ in found} == {"background", "left ventricular myocardium"}
    table = child.truth.table
    walls = [value for value in table.tissue_values if table[value].wall_of is not None]
    for name, radius, line in found:
        labels = child.truth.label(segment_points(line))
        assert radius == 0.0
        assert np.isin(labels, walls if name == "background" else [9]).all(), name
