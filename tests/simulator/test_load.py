"""Loading a case: only what is needed, and with the plain install."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from heartcase.schemas.bundle.format import FileRole
from heartcase.schemas.bundle.reader import OpenBundle, open_bundle
from heartcase.schemas.errors import BundleError, SimulationError, UsageError
from heartcase.simulator.dynamics.step_size import default_step, step_limit
from heartcase.simulator.load import load_case
from heartcase.simulator.surface.deform import deform, make_surface
from tests.factories import TABLE, block_grid
from tests.simulator.lattices import EPS


def test_lattice_is_the_grid_of_the_case(case_path):
    grid = block_grid((8, 5, 4))
    case = load_case(case_path)
    np.testing.assert_array_equal(case.model.node_index, grid.nodes)
    np.testing.assert_array_equal(case.model.node_is_fixed, grid.fixed == 1)
    np.testing.assert_allclose(case.model.rest_positions_mm(), grid.node_positions_mm(), atol=1e-9)
    figures = case.manifest.simulation
    assert case.model.node_count == figures.node_count
    assert default_step(case.model) == pytest.approx(figures.step_default_s, rel=1e-5)
    assert step_limit(case.model) == pytest.approx(figures.step_limit_s, rel=1e-5)
    assert case.model.tissue_volume_ml == pytest.approx(figures.tissue_volume_ml, rel=1e-5)


def test_surface_at_rest_is_the_surface_of_the_case(case_path):
    case = load_case(case_path, needs=("tangents", "colours"))
    mesh = open_bundle(case_path).arrays(FileRole.SURFACE)
    still = deform(case.model, case.surface, np.zeros((case.model.node_count, 3), np.float32))
    np.testing.assert_allclose(still.vertices_mm, mesh["vertices"], atol=4 * EPS * 50)
    np.testing.assert_allclose(still.normals, mesh["normals"], atol=10 * EPS)
    assert still.tangents.shape == (len(mesh["render_to_welded"]), 4)
    red, green, blue = (int(TABLE[9].colour[at : at + 2], 16) for at in (1, 3, 5))
    assert (case.triangle_colours == (red, green, blue)).all()


def test_only_what_is_needed_is_read(case_path, monkeypatch):
    read = []
    arrays = OpenBundle.arrays

    def watched(bundle, role, names=None):
        read.append((role, tuple(names or ())))
        return arrays(bundle, role, names)

    monkeypatch.setattr(OpenBundle, "arrays", watched)
    case = load_case(case_path, needs=("grid",))
    assert [role for role, _ in read] == [FileRole.GRID]
    assert case.surface is None
    assert case.picking is None
    read.clear()
    case = load_case(case_path, needs=("picking",))
    assert [role for role, _ in read] == [FileRole.GRID, FileRole.PICKING]
    assert case.picking is not None
    read.clear()
    load_case(case_path, needs=("surface",))
    assert not any("tangent" in names for _, names in read)


def test_unknown_need_is_refused(case_path):
    with pytest.raises(UsageError, match=r"sound; it can need grid, surface"):
        load_case(case_path, needs=("grid", "sound"))


def test_unknown_curvature_is_refused_whatever_is_needed(case_path):
    for needs in (("grid",), ("surface",)):
        with pytest.raises(UsageError, match=r"curvature: .*flagged, all, none \(found 'smooth'\)"):
            load_case(case_path, needs=needs, curvature="smooth")
    model = load_case(case_path, needs=("grid",)).model
    mapping = open_bundle(case_path).arrays(FileRole.MAPPING)
    with pytest.raises(SimulationError, match="mode: must be one of"):
        make_surface(
            model,
            triangle_nodes=mapping["triangle_nodes"],
            weights=mapping["weights"],
            offset_mm=mapping["offset"],
            normal=mapping["normal"],
            curvature=mapping["curvature"],
            mode="smooth",
        )


def test_missing_case_is_one_line(tmp_path):
    with pytest.raises(BundleError, match="nothing at this path"):
        load_case(tmp_path / "absent.case")


PLAIN = """
import importlib.abc, sys

class Block(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {extras}:
            raise ModuleNotFoundError(f"{{name}} is not installed", name=name)

sys.meta_path.insert(0, Block())
import pkgutil
import heartcase.simulator
for module in pkgutil.walk_packages(heartcase.simulator.__path__, "heartcase.simulator."):
    __import__(module.name)
from heartcase.simulator.load import load_case
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.session.script import default_script, run_script
case = load_case({path!r}, needs=("surface", "tangents", "colours", "picking"))
simulation = Simulation(case.model, surface=case.surface, picking=case.picking)
summary = run_script(simulation, default_script(case.model, case.surface, seconds=0.02))
assert summary.displacement_max_mm > 0
simulation.surface_now(), simulation.picking_now()
from heartcase.cli.main import main
assert main(["simulate", {path!r}, "--seconds", "0.01"]) == 0
assert main(["simulate", {path!r}, "--seconds", "0.01", "--picture", {picture!r}]) == 1
assert not set(sys.modules) & {extras}
print("steps", summary.step_count)
"""


def test_plain_install_loads_steps_and_says_what_is_missing(case_path, tmp_path):
    extras = {
        "SimpleITK", "vtk", "vtkmodules", "pyvista", "skimage", "scipy", "trimesh", "meshio", "PIL", "matplotlib",
        "nrrd", "pydicom", "pygltflib", "xatlas", "edt", "cc3d", "fast_simplification", "imageio", "jinja2",
    }  # fmt: skip
    code = PLAIN.format(extras=extras, path=str(case_path), picture=str(tmp_path / "a.png"))
    done = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    assert "steps" in done.stdout
    assert "pip install '.[prepare]'" in done.stderr
    assert not (tmp_path / "a.png").exists()
