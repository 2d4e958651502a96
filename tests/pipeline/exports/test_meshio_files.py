"""VTU, VTK, Gmsh and Abaqus: read by meshio, by VTK, and by what a cell is."""

from __future__ import annotations

import re

import meshio
import numpy as np
import pytest
import pyvista

from heartcase.pipeline.exports.meshio_files import grid_hexahedra, hexahedra_bytes, surface_bytes
from heartcase.pipeline.exports.models import hollow_model
from heartcase.schemas.bundle.format import FileRole
from heartcase.schemas.bundle.reader import open_bundle
from tests.readers.test_readers import ROOT

NAMES = {
    2: "TISSUE_2_LEFT_VENTRICULAR_MYOCARDIUM",
    3: "TISSUE_3_AORTA_WALL",
}


@pytest.fixture(scope="module")
def bundle():
    """An oblique grid of 25 cells, some partly covered, of two tissues."""
    return open_bundle(ROOT / "tests" / "golden" / "lopsided.case")


@pytest.fixture(scope="module")
def hexahedra(bundle):
    return grid_hexahedra(bundle)


def written(directory, content, suffix):
    path = directory / f"mesh{suffix}"
    path.write_bytes(content)
    return path


def test_the_cells_are_the_cubes_that_the_format_describes(bundle, hexahedra):
    grid = bundle.arrays(FileRole.GRID)
    geometry, figures = bundle.manifest.grid_geometry, bundle.manifest.simulation
    np.testing.assert_allclose(hexahedra.points_mm, geometry.index_to_world(grid["nodes"] - 0.5), atol=1e-12)
    corners = hexahedra.points_mm[hexahedra.hexahedra]
    np.testing.assert_allclose(corners.mean(axis=1), geometry.index_to_world(grid["cells"]), atol=1e-9)
    # the first corner's three edges span +h^3: none is mirrored
    edges = np.stack([corners[:, n] - corners[:, 0] for n in (1, 3, 4)], axis=1)
    np.testing.assert_allclose(np.linalg.det(edges), figures.cell_mm**3, rtol=1e-9)
    assert hexahedra.fixed.sum() == figures.fixed_node_count


@pytest.mark.parametrize("suffix", [".vtu", ".vtk", ".msh", ".inp"])
def test_hexahedra_in_meshio(hexahedra, tmp_path, suffix):
    content = hexahedra_bytes(hexahedra, suffix)
    assert content == hexahedra_bytes(hexahedra, suffix)
    read = meshio.read(written(tmp_path, content, suffix))
    assert np.abs(read.points - hexahedra.points_mm).max() < 1e-9
    (block,) = read.cells
    assert block.type == "hexahedron"
    np.testing.assert_array_equal(block.data, hexahedra.hexahedra)
    if suffix == ".inp":
        assert set(read.cell_sets) == set(NAMES.values())
        for value, name in NAMES.items():
            np.testing.assert_array_equal(
                np.concatenate(read.cell_sets[name]), np.flatnonzero(hexahedra.label == value)
            )
        np.testing.assert_array_equal(read.point_sets["FIXED"], np.flatnonzero(hexahedra.fixed))
        return
    label = read.cell_data["gmsh:physical" if suffix == ".msh" else "label"][0]
    np.testing.assert_array_equal(label, hexahedra.label)
    for name in ("coverage", "youngs_modulus_kpa", "density_kg_m3"):
        np.testing.assert_array_equal(read.cell_data[name][0].astype(np.float32), getattr(hexahedra, name))
    np.testing.assert_array_equal(read.point_data["fixed"], hexahedra.fixed)
    if suffix == ".msh":
        assert {name: list(tag) for name, tag in read.field_data.items()} == {n: [v, 3] for v, n in NAMES.items()}


def test_abaqus_gets_the_element_that_every_code_knows(hexahedra):
    text = hexahedra_bytes(hexahedra, ".inp").decode("ascii")
    assert re.findall(r"^\*ELEMENT.*$", text, re.M) == ["*ELEMENT, TYPE=C3D8"]
    assert len(re.findall(r"^\*[EN]LSET|^\*[EN]SET", text, re.M)) == 3
    assert max(map(len, text.splitlines())) < 256


@pytest.mark.parametrize("suffix", [".vtu", ".vtk"])
def test_hexahedra_in_vtk(bundle, hexahedra, tmp_path, suffix, capfd):
    figures = bundle.manifest.simulation
    seen = pyvista.read(written(tmp_path, hexahedra_bytes(hexahedra, suffix), suffix))
    assert set(seen.celltypes) == {pyvista.CellType.HEXAHEDRON}
    assert set(seen.cell_data) == {"label", "coverage", "youngs_modulus_kpa", "density_kg_m3"}
    assert set(seen.point_data) == {"fixed"}
    quality = seen.cell_quality(["scaled_jacobian", "volume"])
    np.testing.assert_allclose(quality["scaled_jacobian"], 1.0, atol=1e-9)
    assert quality["volume"].sum() == pytest.approx(figures.cell_count * figures.cell_mm**3, rel=1e-9)
    tissue_ml = (quality["volume"] * seen["coverage"]).sum() / 1000.0
    assert tissue_ml == pytest.approx(figures.tissue_volume_ml, rel=1e-6)
    assert tissue_ml < 0.95 * quality["volume"].sum() / 1000.0
    # VTK tells what it cannot read on its own error channel only
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("suffix", [".vtu", ".vtk"])
def test_a_surface_in_meshio_and_vtk(bundle, tmp_path, suffix, capfd):
    mesh = hollow_model(bundle)
    content = surface_bytes(mesh, suffix)
    assert content == surface_bytes(mesh, suffix)
    path = written(tmp_path, content, suffix)
    read = meshio.read(path)
    np.testing.assert_array_equal(read.points, mesh.vertices_mm)
    np.testing.assert_array_equal(read.cells_dict["triangle"], mesh.triangles)
    seen = pyvista.read(path)
    assert set(seen.cell_data) == {"triangle_label", "triangle_tissue", "triangle_is_cut", "triangle_kind"}
    for name in seen.cell_data:
        np.testing.assert_array_equal(read.cell_data[name][0], getattr(mesh, name))
        np.testing.assert_array_equal(seen.cell_data[name], getattr(mesh, name))
    np.testing.assert_array_equal(seen.point_data["normals"], mesh.normals)
    corners = mesh.vertices_mm[mesh.triangles].astype(float)
    enclosed = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0
    assert seen.extract_surface(algorithm=None).volume == pytest.approx(enclosed, rel=1e-5)
    assert capfd.readouterr().err == ""
