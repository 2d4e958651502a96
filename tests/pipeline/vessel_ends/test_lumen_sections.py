"""Sections of tubes of known radius and direction."""

import numpy as np
import pytest

from heartcase.pipeline.vessel_ends.lumen_sections import Lumen, across, angle_between
from tests.pipeline.lattices import LATTICES, lattice
from tests.pipeline.vessel_shapes import ball, line, tube

AXIS = np.array([0.48, 0.6, 0.64])
KINDS = sorted(LATTICES)


def side_of(axis):
    side = np.cross(axis, [1.0, 0.0, 0.0])
    return side / np.linalg.norm(side)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("tilt", [0.0, 30.0])
def test_a_section_of_a_tube_has_the_area_of_the_ellipse(kind, tilt):
    geometry = lattice(kind, 60.0)
    radius = 7.0
    lumen = Lumen.of(tube(geometry, line(tuple(-26 * AXIS), tuple(26 * AXIS)), radius), geometry)
    axis = np.cos(np.radians(tilt)) * AXIS + np.sin(np.radians(tilt)) * side_of(AXIS)
    found = lumen.section(np.array((1.0, -1.0, 0.5)), axis, 20.0)
    stretch = 1.0 / np.cos(np.radians(tilt))
    voxel = max(geometry.spacing_mm)
    assert found.is_whole
    assert found.area_mm2 == pytest.approx(np.pi * radius**2 * stretch, rel=0.06)
    assert found.extent_mm == pytest.approx(radius * stretch, abs=voxel)
    off = found.middle - (found.middle @ AXIS) * AXIS
    assert np.linalg.norm(off) < 0.3 * voxel


@pytest.mark.parametrize("kind", KINDS)
def test_a_plane_that_is_off_and_tilted_comes_to_lie_across(kind):
    geometry = lattice(kind, 60.0)
    lumen = Lumen.of(tube(geometry, line(tuple(-26 * AXIS), tuple(26 * AXIS)), 6.0), geometry)
    tilted = np.cos(0.6) * AXIS + np.sin(0.6) * side_of(AXIS)
    found = across(lumen, 3.0 * side_of(AXIS), tilted, 24.0)
    assert angle_between(found.axis, AXIS) < 5.0
    assert np.linalg.norm(found.middle - (found.middle @ AXIS) * AXIS) < 0.6


def test_the_nearest_piece_is_taken_and_its_rival_told():
    geometry = lattice("even", 70.0)
    two = tube(geometry, line((-9.0, 0.0, -20.0), (-9.0, 0.0, 20.0)), 5.0)
    two |= tube(geometry, line((11.0, 0.0, -20.0), (11.0, 0.0, 20.0)), 5.0)
    lumen = Lumen.of(two, geometry)
    up = np.array((0.0, 0.0, 1.0))
    found = lumen.section(np.array((-1.0, 0.0, 0.0)), up, 30.0)
    assert found.middle[0] == pytest.approx(-9.0, abs=0.3)
    assert found.away_mm == pytest.approx(3.0, abs=0.9)
    assert found.rival_mm == pytest.approx(7.0, abs=0.9)
    alone = lumen.section(np.array((-9.0, 0.0, 0.0)), up, 12.0)
    assert alone.away_mm < 0.9
    assert alone.rival_mm == np.inf


def test_what_reaches_beyond_the_limit_or_is_not_there_is_told():
    geometry = lattice("even", 60.0)
    lumen = Lumen.of(ball(geometry, (0.0, 0.0, 0.0), 15.0), geometry)
    assert not lumen.section(np.zeros(3), AXIS, 10.0).is_whole
    assert lumen.section(np.zeros(3), AXIS, 20.0).is_whole
    assert lumen.section(25.0 * AXIS, AXIS, 20.0) is None
    assert across(lumen, np.zeros(3), AXIS, 10.0) is None
