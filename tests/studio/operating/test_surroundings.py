"""What a page is told of the heart's own planes, and of the vessels that cannulae lie in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from heartcase.pipeline.bundle.write_bundle import write_bundle
from heartcase.schemas.landmarks import Landmark
from heartcase.simulator.load import load_case
from heartcase.studio.operating.scene.heart_axes import heart_axes
from heartcase.studio.operating.scene.surroundings import cannulae
from tests.factories import TABLE
from tests.studio.operating.two_walls import INNER, two_walls

PLACES = {
    "apex": (20.0, -14.0, 0.0),
    "mitral valve": (20.0, -14.0, 60.0),
    "tricuspid valve": (0.0, -14.0, 55.0),
    "aortic valve": (20.5, -14.0, 12.0),
}


def marks(*names):
    return tuple(Landmark(name=name, kind="point", points_mm=(PLACES[name],)) for name in names)


def end(code, **more):
    return {"label": TABLE.find_code(code).name, "position_mm": [20, -14, 40], "axis": [0, 0, 2], "radius_mm": 8} | more


def written(folder, **options):
    write_bundle(folder / "two.case", two_walls(**options))
    return folder / "two.case"


def test_planes_are_those_of_the_landmarks(tmp_path):
    found = heart_axes(written(tmp_path, landmarks=marks("apex", "mitral valve", "tricuspid valve")))
    assert set(found["planes"]) == {"short_axis", "four_chamber", "two_chamber"}
    assert found["centre_mm"] == [20.0, -14.0, 30.0]
    normals = {name: np.array(one["towards"]) for name, one in found["planes"].items()}
    # the long axis goes along z, the right heart lies along x
    for name, axis in (("short_axis", 2), ("four_chamber", 1), ("two_chamber", 0)):
        assert abs(normals[name][axis]) == pytest.approx(1.0)
    for one in found["planes"].values():
        # right and up on the screen, and towards the viewer
        assert np.cross(one["right"], np.negative(one["down"])) == pytest.approx(one["towards"])


def test_a_case_without_landmarks_and_labels_has_no_planes(tmp_path):
    assert heart_axes(written(tmp_path)) == {"planes": {}, "centre_mm": None}


def test_caval_cannulae_lie_in_the_ends_of_their_veins(tmp_path):
    ends = [end("48345005"), end("48345005", position_mm=[0, 0, 0]), end("15825003"), {"label": "aorta"}]
    case = load_case(written(tmp_path, ends=ends), needs=("surface", "structures"))
    (found,) = cannulae(case)
    assert found == {
        "vessel": "superior",
        "tip_mm": [20.0, -14.0, 24.0],
        "wall_mm": [20.0, -14.0, 40.0],
        "out": [0.0, 0.0, 1.0],
        "radius_mm": 4.0,
    }


def test_an_aortic_cannula_is_in_the_front_of_the_aorta_above_its_valve(tmp_path):
    case = load_case(written(tmp_path, landmarks=marks("aortic valve")), needs=("surface", "structures"))
    # no wall of an aorta
    assert cannulae(case) == []
    assert TABLE.find_code("15825003").value == next(one.wall_of for one in TABLE if one.value == INNER)
    aorta = replace(case, triangle_structures=np.full_like(case.triangle_structures, INNER))
    (found,) = cannulae(aorta)
    wall = np.array(found["wall_mm"])
    # of the block's front, which is at y = -21.5, what is 36 mm above the valve at most
    assert wall[1] == pytest.approx(-21.5)
    assert 12.0 + 15.0 < wall[2] <= 40.5
    # its tip is behind the wall, inside
    assert found["tip_mm"][1] > wall[1]
    assert found["out"][1] < 0.0
