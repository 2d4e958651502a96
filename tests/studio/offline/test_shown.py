"""What the page shows of a case besides its moving surface."""

import json

import numpy as np
import pytest

from heartcase.phantom.anatomy.shapes import Tube
from heartcase.schemas.bundle.format import FileRole
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.bundle.surface_kinds import SurfaceKind
from heartcase.simulator.load import load_case
from heartcase.studio.offline.shown import FIRST_VESSEL, shown_of
from heartcase.studio.offline.surfaces import RIM, SurfaceArrays, middle_level, surface_of
from heartcase.studio.offline.web_page import case_script
from tests.studio.offline.cases import LINE, write_cases
from tests.studio.page.test_offline import contents_of


def arrays_of(part):
    """The arrays of a message of the file."""
    size = 4 + int.from_bytes(part[:4], "little")
    table = json.loads(part[4:size])["arrays"]
    return {
        name: np.frombuffer(part, one["dtype"], count=int(np.prod(one["shape"])), offset=size + one["at"]).reshape(
            one["shape"]
        )
        for name, one in table.items()
    }


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    return write_cases(tmp_path_factory.mktemp("shown"), ["one"])[0]


def test_every_triangle_is_of_a_structure_that_is_listed(case):
    bundle = open_bundle(case)
    shown, surface = shown_of(bundle, 1), surface_of(bundle, 1)
    listed = {one["value"] for one in shown.structures if one["part"] != "vessel"}
    assert set(np.unique(shown.of_triangles).tolist()) == listed
    assert len(shown.of_triangles) == len(surface.triangles)
    by_value = {one["value"]: one for one in shown.structures}
    table = bundle.manifest.labels
    for value in listed:
        assert by_value[value]["name"] == table[value].name
        assert by_value[value]["part"] == ("outside" if table[value].role.is_tissue else "inside")
    assert by_value[1]["blood"] == "rich"
    assert by_value[2]["blood"] == "poor"


def test_rims_and_devices_are_structures_of_their_own():
    flat = np.zeros((3, 3), np.float32)
    void, tissue = np.array([0, 4, 4, 4], np.uint8), np.array([9, 9, 9, 42], np.uint8)
    triangles = np.zeros((4, 3), np.int32)
    kind = np.array([SurfaceKind.EPICARDIUM, SurfaceKind.ENDOCARDIUM, SurfaceKind.DEFECT_RIM, SurfaceKind.DEVICE])
    surface = SurfaceArrays(flat, flat, triangles, void, tissue, kind.astype(np.uint8))
    assert surface.structures.tolist() == [9, 4, RIM, 42]
    assert SurfaceArrays(flat, flat, triangles, void, tissue, None).structures.tolist() == [9, 4, 4, 4]


def test_vessels_have_a_surface_and_carry_the_aortas_blood(case):
    shown = shown_of(open_bundle(case), 1)
    artery, vein = (one for one in shown.structures if one["part"] == "vessel")
    assert (artery["name"], vein["name"]) == ("right coronary artery", "great cardiac vein")
    assert (artery["value"], vein["value"]) == (FIRST_VESSEL, FIRST_VESSEL + 1)
    assert (artery["blood"], vein["blood"]) == ("rich", "unknown")
    exact = Tube(np.array(LINE), np.full(3, 1.5))
    np.testing.assert_allclose(exact.distance(shown.vessels["right coronary artery"].vertices_mm), 0.0, atol=1e-3)
    assert [one["name"] for one in shown.landmarks] == ["atriotomy", "mid muscular defect", "apex"]
    incision, ring, _ = shown.landmarks
    assert (incision["kind"], incision["depth"]) == ("incision", 3.0)
    assert ring["closed"]
    np.testing.assert_allclose(np.linalg.norm(ring["points"], axis=1), 6.0, atol=0.02)


def test_the_plane_through_a_defect_holds_it(case):
    plane = shown_of(open_bundle(case), 1).axes["planes"]["lesion"]
    towards = np.array(plane["towards"])
    for place in ([0, 0, 0], [20, -20, -30]):
        assert abs((np.array(place) - plane["point_mm"]) @ towards) < 1e-9
    np.testing.assert_allclose(np.cross(plane["down"], plane["right"]), towards, atol=1e-9)
    assert abs(np.linalg.norm(towards) - 1.0) < 1e-9


def test_tissue_that_a_cut_alone_shows_has_a_colour(case):
    shown = shown_of(open_bundle(case), 1)
    labels = set(np.unique(open_bundle(case).arrays(FileRole.GRID, ("cell_label",))["cell_label"]).tolist())
    listed = {one["value"] for one in shown.structures} | {one["value"] for one in shown.inside}
    assert labels <= listed
    assert not {one["value"] for one in shown.structures} & {one["value"] for one in shown.inside}


def test_the_script_holds_the_surface_of_the_case(case):
    bundle = open_bundle(case)
    level = middle_level(bundle)
    assert level == 1
    script = case_script(load_case(case, needs=("surface",), level=level), shown_of(bundle, level)).decode("ascii")
    assert script.startswith('globalThis.heartcaseData = "')
    assert not set("<>&") & set(script)
    table, parts = contents_of(script.split('"')[1])
    arrays = arrays_of(parts[table["case"][0]])
    stored = surface_of(bundle, level).vertices_mm[arrays["vertex"]]
    np.testing.assert_allclose(arrays["rest_mm"], stored, atol=1e-4)
    assert len(table["case"]) == 4
