"""Every kernel compiles on this Python, and a sample case made and moved with them is that of the other Pythons.

``make versions`` runs this with an empty cache of numba's on every Python that is promised, after tests of what the
case does not use. The first writes what it found to the folder that HEARTCASE_VERSIONS names, the others compare.
"""

from __future__ import annotations

import json
import os
import platform
import re
import sys
from contextlib import nullcontext
from pathlib import Path
from unittest.mock import patch

import numba
import numpy as np
import pytest

from heartcase.cli.main import main
from heartcase.compiling.kernel import KERNELS
from heartcase.compiling.loops import LoopKernel
from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.pipeline.building.session_file import open_session
from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.watershed import forest, voxel_labels
from heartcase.pipeline.watershed.painting import paint_boxes
from heartcase.pipeline.watershed.tree import build_basin_tree
from heartcase.schemas.bundle.manifest import listed_files
from heartcase.schemas.recipe.settings import Stroke
from heartcase.simulator.cutting.blade_sheet import Sheet
from heartcase.simulator.cutting.parted_lattice import part
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.haptics.coupling import TissueSample
from heartcase.simulator.haptics.device import DeviceReading
from heartcase.simulator.haptics.loop import LoopNumbers
from heartcase.simulator.haptics.poses import ToolPose
from heartcase.simulator.haptics.settings import ServoSettings
from heartcase.simulator.incisions.nearness import to_structure
from heartcase.simulator.incisions.surgical_freedom import Shaft, reach
from heartcase.simulator.incisions.triangle_tree import triangle_tree
from heartcase.simulator.incisions.visibility import View, visibility
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.load import load_case
from heartcase.simulator.mesh_arrangement.sheet_sides import directions_of
from heartcase.simulator.mesh_arrangement.surface_crossings import is_inside
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.surface_splitting.cuttable_surface import CuttableSurface
from heartcase.simulator.surface_splitting.split_surface import split_surface
from tests.compiling.all_modules import import_all

pytestmark = pytest.mark.versions

RECIPE = Path(__file__).parents[2] / "sample_cases" / "adult_phantom.toml"
LAWS = {
    "springs": ForceLaw("springs"),
    "springs at a ratio of 0.45": ForceLaw("springs", 0.45),
    "element": ForceLaw("element"),
    "element at a ratio of 0.45": ForceLaw("element", 0.45),
    "element that shares no strain": ForceLaw("element", shares_strain=False),
}
MOTION_MM = 1e-4
"""How far nodes may be apart on two Pythons after 60 steps in which a hand pulls by 5 mm."""


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    folder = tmp_path_factory.mktemp("out")
    with pytest.MonkeyPatch.context() as patch:
        # What another process compiled is loaded with all that it calls, none of which is then compiled here.
        patch.setattr("heartcase.pipeline.building.kernels_ahead.kernels_ahead", lambda *_, **__: nullcontext())
        assert main(["build", str(RECIPE), "--out", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def case(out):
    return load_case(out / "adult-phantom.case", needs=("surface", "picking"))


@pytest.fixture(scope="module")
def found(out, case):
    """What must be the same on every Python: the case's files by their role, and where a few nodes are after a pull."""
    files = {f"{role} {name}": digest for name, role, _, digest in listed_files(out / "adult-phantom.case")}
    return {"files": files, "motion": {name: moved(case, law) for name, law in LAWS.items()}}


def moved(case, law: ForceLaw) -> list[list[float]]:
    model = case.model.with_law(law)
    simulation = Simulation(model, surface=case.surface, picking=case.picking)
    marks = {mark.name: mark.points_mm[0] for mark in case.manifest.landmarks}
    hand = simulation.grab(marks["apex"], 8.0)
    probe = simulation.probe(np.add(marks["apex"], (0.0, 0.0, 30.0)), 6.0)
    for number in range(6):
        simulation.lead(hand, np.multiply((5.0, 0.0, 0.0), (number + 1) / 6.0))
        simulation.move(probe, np.add(marks["apex"], (0.0, 0.0, 30.0 - number)))
        simulation.step(10)
        simulation.surface_now(), simulation.picking_now()
    assert np.isfinite(simulation.force_on(hand)).all()
    assert np.abs(simulation.force_on(hand)).max() > 0.0
    simulation.energy(), simulation.watch()
    return simulation.positions_mm()[:: model.node_count // 200].tolist()


def test_a_session_paints_and_erases(out, tmp_path):
    recipe = open_session(RECIPE, out=out)
    session, before = recipe.session, recipe.session.labels.copy()
    session.paint(Stroke(label="aorta", radius_mm=3.0, points_mm=[(0.0, 0.0, 0.0), (10.0, 0.0, 0.0)]))
    assert (session.labels != before).any()
    session.paint(Stroke(erase=True, radius_mm=3.0, points_mm=[(0.0, 0.0, 0.0), (10.0, 0.0, 0.0)]))
    assert session.suggest(count=2).places
    session.undo(), session.undo()
    session.put_off()
    np.testing.assert_array_equal(session.labels, before)
    # Labels of a box that is put off, by a table of all basins.
    with patch.multiple(voxel_labels, MOST_AT_ONCE=0, MOST_LISTED=10**9, MOST_ONE_BY_ONE=0):
        session.paint(Stroke(label="aorta", radius_mm=3.0, points_mm=[(0.0, 0.0, 0.0), (10.0, 0.0, 0.0)]))
        assert session.put_off_tiles.any()
        found = session.labels_of_box((slice(None), slice(None), slice(None)))
    assert paint_boxes.overloads
    np.testing.assert_array_equal(found, session.labels)


def test_strokes_divide_what_is_flat():
    nothing = np.full((1, 1, 9), UNMARKED, np.uint8)
    found = forest.solve_forest(build_basin_tree(np.zeros(nothing.shape, np.float32)), nothing)
    for voxel, label in ((0, 1), (8, 2), (3, 1)):
        found.paint(np.array([voxel]), label)
    assert found.labels.ravel().tolist() == [1] * 6 + [2] * 3


def test_the_phantom_knows_its_truth(tmp_path):
    assert main(["phantom", str(tmp_path / "child"), "--size", "child", "--spacing", "4"]) == 0
    assert (tmp_path / "child" / "truth.nii.gz").exists()
    truth = HeartPhantom.child().truth
    border = truth.surface_points(1)[::200]
    assert np.abs(truth.distance(border, 1)).max() < 0.1


def test_ends_are_found(out, tmp_path, capsys):
    text = re.sub(r"^\[\[ends\]\].*?(?=^\[)", "", RECIPE.read_text(), flags=re.DOTALL | re.MULTILINE)
    recipe = tmp_path / "without_ends.toml"
    recipe.write_text(text.replace('"../out/', f'"{RECIPE.parents[1].as_posix()}/out/'))
    assert main(["suggest", str(recipe), "--out", str(out), "--ends", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["ends"]) >= 4


def test_springs_go_and_come(case):
    simulation = Simulation(case.model)
    simulation.remove_springs(np.arange(case.model.spring_count) % 50 == 0)
    assert Simulation(simulation.model).step_limit_s > 0.0
    simulation.add_springs([[0, case.model.node_count - 1]], 0.1)
    simulation.step(5)
    assert np.isfinite(simulation.positions_mm()).all()


def test_a_cut_parts_the_lattice(case):
    model = case.model
    tissue = TissueSamples.inside(model.geometry.world_to_index(case.surface.rest_mm) + 0.5, case.surface.triangles)
    x, y, z = model.node_index.mean(axis=0)
    blade = [[(x - 60, y, z - 60), (x + 60, y, z - 60)], [(x - 60, y, z + 60), (x + 60, y, z + 60)]]
    parted = part(model.with_law(LAWS["element"]), [Sheet.swept(blade)], tissue)
    assert parted.model.node_count > model.node_count
    # A sheet that ends inside: only where nothing was cut before is it parted like this.
    middle = model.node_index[model.cell_corners[model.cell_count // 2]].mean(axis=0)
    short = 2.4 * np.array([[[-1, -1, 0], [1, -1, 0]], [[-1, 1, 0], [1, 1, 0]]])
    assert part(model, [Sheet.swept(middle + short)], tissue).model.cell_count > model.cell_count
    across = [[(x, y - 60, z - 60), (x, y + 60, z - 60)], [(x, y - 60, z + 60), (x, y + 60, z + 60)]]
    sheets = [Sheet.swept(blade), Sheet.swept(across)]
    cuttable = CuttableSurface.of(model, case.surface)
    split = split_surface(cuttable, part(model, sheets, cuttable.samples()), sheets)
    assert split.triangle_part.max() > 0
    # What only sheets in one place, or inside the tissue, ask.
    assert directions_of(cuttable.mesh.vertices[:2]).shape == (2, 3)
    assert not is_inside(
        cuttable.mesh.vertices,
        cuttable.mesh.triangles,
        cuttable.mesh.buckets,
        cuttable.mesh.vertices.min(axis=0) - 1,
    )


def test_moving_tissue_is_cut(case):
    """On the CPU, with ghosts, and a blade that is followed back to rest."""
    model = case.model.with_law(LAWS["element"])
    simulation = Simulation(model, surface=case.surface, step_s=1e-4, damping_per_s=100.0)
    corner = model.rest_positions_mm()[0]
    hand = simulation.grab(corner, 8.0)
    simulation.lead(hand, (0.0, 0.0, 1.0))
    simulation.step(3)
    x, y, z = model.rest_positions_mm().mean(axis=0)
    simulation.cut([[(x - 60, y - 9, z - 60), (x + 60, y + 9, z - 60)], [(x - 60, y, z + 60), (x + 60, y, z + 60)]])
    once = simulation.model
    assert once.node_count > model.node_count
    simulation.cut([[(x - 60, y + 30, z - 9), (x + 60, y + 30, z + 9)], [(x - 60, y, z - 9), (x + 60, y, z + 9)]])
    assert simulation.model.node_count > once.node_count
    simulation.probe(corner, 6.0)
    simulation.step(3)
    assert np.isfinite(simulation.surface_now().vertices_mm).all()


def test_a_hand_is_felt():
    reading = DeviceReading(ToolPose.at(np.zeros(3)))
    loop = LoopNumbers(0.0, reading, ServoSettings())
    loop.update(0.001, reading, TissueSample(0.0, reading.pose, np.ones((2, 3)), np.ones(2)).row())
    assert np.abs(loop.load).max() > 0.0


def test_an_incision_is_measured(case):
    rest, triangles = case.surface.rest_mm, case.surface.triangles
    tree = triangle_tree(rest, triangles)
    middle = rest.mean(axis=0)
    rim = middle + 5.0 * np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    assert 0.0 <= visibility(tree, rim, View((0.0, 0.0, 1.0), eye_count=4)).rim_seen <= 1.0
    reach(tree, rim, Shaft((0.0, 0.0, 1.0)), depth_mm=4.0, spacing_mm=2.0)
    assert to_structure(rim, rest, triangles, np.ones(len(triangles), bool), name="tissue").distance_mm >= 0.0


def test_the_others_found_the_same(found):
    folder = os.environ.get("HEARTCASE_VERSIONS")
    if not folder:
        pytest.skip("HEARTCASE_VERSIONS names no folder to compare in: run it by `make versions`")
    here = "{}.{}".format(*sys.version_info)
    about = f"Python {platform.python_version()}, numba {numba.__version__}, NumPy {np.__version__}"
    first = Path(folder) / "first.json"
    if not first.exists():
        first.parent.mkdir(parents=True, exist_ok=True)
        first.write_text(json.dumps(found | {"about": about}))
        print(f"\n{about}: the first; the others are compared with it")
        return
    other = json.loads(first.read_text())
    gaps = {
        name: float(np.linalg.norm(np.subtract(now, other["motion"][name]), axis=1).max())
        for name, now in found["motion"].items()
    }
    same = sum(other["files"].get(name) == digest for name, digest in found["files"].items())
    print(f"\n{about}, beside {other['about']}:")
    print(f"  {same} of {len(other['files'])} files of the case have the same bytes")
    print("  nodes apart after a pull, mm: " + ", ".join(f"{name} {gap:.2g}" for name, gap in gaps.items()))
    assert max(gaps.values()) <= MOTION_MM
    if os.environ.get("HEARTCASE_OTHER_PACKAGES") != "1":
        assert found["files"] == other["files"], f"a case made on {here} has other bytes"


def test_every_kernel_was_compiled(found):
    import_all()
    # What is inlined before types are known is compiled as a part of its callers, and nowhere else.
    kernels = [one for one in KERNELS if one.py_func.__module__.startswith("heartcase.")]
    own = [one for one in kernels if isinstance(one, LoopKernel) or one.targetoptions.get("inline") != "always"]
    missing = [f"{one.py_func.__module__}.{one.py_func.__qualname__}" for one in own if not one.overloads]
    print(f"\n{len(own)} kernels, {len(missing)} not compiled")
    assert not missing, "\n".join(missing)
