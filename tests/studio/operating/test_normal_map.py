"""The normal map that a page is sent: each corner of a triangle where the case has it, and none where a blade was."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from heartcase.schemas.bundle.format import FileRole
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.recording.commands import Cut
from heartcase.simulator.live.live import Live
from heartcase.simulator.load import load_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.simulation import Simulation
from heartcase.studio.operating.scene.normal_map import load_normal_map
from heartcase.studio.operating.scene.packing import topology_message
from tests.studio.operating.charts import write_charted
from tests.studio.operating.performing import unpacked


@pytest.fixture
def charted(tmp_path):
    path, surface = write_charted(tmp_path)
    case = load_case(path, needs=("surface", "structures", "tissue"))
    return path, case, surface, load_normal_map(path, case.surface)


def test_each_corner_of_a_triangle_has_its_place_on_the_map_and_its_tangent(charted):
    _, case, surface, normal_map = charted
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(normal_map.png))), surface.normal_map)
    session = OperatingSession(Simulation(case.model, surface=case.surface, tissue=case.tissue))
    live = Live(session)
    structures = np.arange(len(surface.triangles), dtype=np.int32) % 3
    _, arrays = unpacked(topology_message(1, live.newest, structures, normal_map))
    corners = arrays["triangles"]
    np.testing.assert_array_equal(arrays["vertex"][corners], case.surface.triangles)
    np.testing.assert_array_equal(arrays["structure"][corners], np.repeat(structures[:, None], 3, axis=1))
    np.testing.assert_array_equal(arrays["uv"][corners], surface.render_uv[surface.render_triangles])
    tangents = load_case(charted[0], needs=("surface", "tangents")).surface.tangent
    np.testing.assert_array_equal(arrays["tangent"][corners], tangents[surface.render_triangles])
    # a cut: what is whole keeps its map, what the blade changed has none
    live.do(Cut(poses_mm=tuple(tuple((22.3, y, z) for y in (-18.0, -10.0)) for z in (45.0, 33.0))))
    while live.newest.triangle_origin is None:
        live.tick()
    newest = live.newest
    structures = np.zeros(len(newest.surface.triangles), np.int32)
    _, arrays = unpacked(topology_message(2, newest, structures, normal_map))
    corners = arrays["triangles"]
    np.testing.assert_array_equal(arrays["vertex"][corners], newest.surface.triangles)
    is_charted = arrays["uv"][corners][..., 0] >= 0.0
    assert (is_charted.all(axis=1) | ~is_charted.any(axis=1)).all()
    whole, origin = is_charted.all(axis=1), newest.triangle_origin
    assert not whole[origin < 0].any()
    assert whole.sum() > 0.5 * len(whole)
    assert (~whole).sum() >= (origin < 0).sum() + 4
    np.testing.assert_array_equal(
        arrays["uv"][corners[whole]], surface.render_uv[surface.render_triangles[origin[whole]]]
    )
    live.close()


def test_a_case_without_a_map_and_one_whose_model_is_broken_have_none(charted, operated_case):
    plain = load_case(operated_case, needs=("surface",))
    assert load_normal_map(operated_case, plain.surface) is None
    path, case, _, normal_map = charted
    assert normal_map is not None
    file = open_bundle(path).path(FileRole.RENDER)
    whole = file.read_bytes()
    for at in (13, 25, len(whole) // 2):
        file.write_bytes(whole[:at] + b"\xff" * 40 + whole[at + 40 :])
        found = load_normal_map(path, case.surface)
        # what can be read is what was written, or nothing is shown
        assert found is None or np.array_equal(case.surface.triangles, found.uncut.triangles)
