"""Meshes through meshio: for ParaView (VTU, VTK) and for finite elements (Abaqus, Gmsh)."""

from __future__ import annotations

import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import numpy.typing as npt

from heartcase.pipeline.exports.models import TaggedMesh
from heartcase.schemas.arrays import Float32, Float64, Int32, UInt8
from heartcase.schemas.bundle.format import FileRole
from heartcase.schemas.bundle.lattice import cell_nodes
from heartcase.schemas.bundle.reader import OpenBundle
from heartcase.schemas.errors import BundleError, Problem, UsageError
from heartcase.schemas.labels import LabelTable

__all__ = ["Hexahedra", "grid_hexahedra", "hexahedra_bytes", "surface_bytes"]


_FORMATS = {".vtu": "vtu", ".vtk": "vtk42", ".inp": "abaqus", ".msh": "gmsh22"}
"""Ending -> meshio's name of the format. Gmsh's version 2.2 is the one that finite-element codes read; of the old VTK
format VTK itself cannot read the bytes and integers that meshio writes as version 5.1."""
_VTK_ORDER = [0, 1, 3, 2, 4, 5, 7, 6]
"""Corner of a cell (:mod:`heartcase.schemas.bundle.lattice`) at each place of a hexahedron: around the lower face, then
the upper one, both counter-clockwise from above. VTK, Abaqus (C3D8) and Gmsh agree in this."""


@dataclass(frozen=True)
class Hexahedra:
    """The simulation grid as a mesh of hexahedra."""

    points_mm: Float64
    """Rest position of each node, patient LPS, mm, shape (node_count, 3)."""
    hexahedra: Int32
    """Node numbers in VTK's order, shape (cell_count, 8); all Jacobians are positive."""
    coverage: Float32
    """Fraction of each cell that is tissue, shape (cell_count,), in (0, 1]."""
    label: UInt8
    """Tissue label of each cell, shape (cell_count,)."""
    youngs_modulus_kpa: Float32
    """Young's modulus of each cell, kPa, shape (cell_count,)."""
    density_kg_m3: Float32
    """Density of each cell, kg/m3, shape (cell_count,)."""
    fixed: UInt8
    """1 where a node is held, shape (node_count,)."""
    table: LabelTable
    """What the labels stand for."""


def grid_hexahedra(bundle: OpenBundle) -> Hexahedra:
    """The grid of a case, in its own order of cells and nodes.

    Raises
    ------
    BundleError
        The grid is damaged, or mirrored.
    """
    grid = bundle.arrays(FileRole.GRID)
    geometry = bundle.manifest.grid_geometry
    nodes, corners = cell_nodes(grid["cells"])
    problems = []
    if not np.array_equal(nodes, grid["nodes"]):
        problems.append(Problem("grid.nodes", "are not the corners of the cells: build the case again"))
    if not geometry.is_right_handed:
        problems.append(Problem("grid_geometry.direction", "is left-handed, so the cells would be mirrored"))
    if problems:
        raise BundleError(problems)
    return Hexahedra(
        points_mm=geometry.index_to_world(nodes - 0.5),
        hexahedra=np.ascontiguousarray(corners[:, _VTK_ORDER]),
        coverage=grid["cell_coverage"],
        label=grid["cell_label"],
        youngs_modulus_kpa=grid["cell_stiffness"],
        density_kg_m3=grid["cell_density"],
        fixed=grid["fixed"],
        table=bundle.manifest.labels,
    )


def surface_bytes(mesh: TaggedMesh, suffix: str) -> bytes:
    """Content of a .vtu or .vtk file of a surface, LPS mm.

    Points have ``normals``; triangles have ``triangle_label``, ``triangle_tissue``, ``triangle_is_cut``, and those of
    a hollow model ``triangle_kind``.
    """
    return _written(
        meshio.Mesh(
            mesh.vertices_mm,
            [("triangle", mesh.triangles)],
            point_data={"normals": mesh.normals},
            cell_data={
                "triangle_label": [mesh.triangle_label],
                "triangle_tissue": [mesh.triangle_tissue],
                "triangle_is_cut": [mesh.triangle_is_cut],
            }
            | ({} if mesh.triangle_kind is None else {"triangle_kind": [mesh.triangle_kind]}),
        ),
        suffix,
    )


def hexahedra_bytes(mesh: Hexahedra, suffix: str) -> bytes:
    """Content of a .vtu, .vtk, .msh or .inp file of hexahedra, LPS mm.

    VTU, VTK and Gmsh hold ``coverage``, ``youngs_modulus_kpa`` and ``density_kg_m3`` of the cells, and ``fixed`` of
    the nodes. The label is cell data in VTU and VTK and a physical group in Gmsh. Abaqus' format has no fields: it
    holds a set of elements for each label and the set of nodes ``FIXED``. Groups and sets are called
    ``TISSUE_value_NAME``.
    """
    cell_data: dict[str, list[npt.NDArray[Any]]] = {
        "coverage": [mesh.coverage],
        "youngs_modulus_kpa": [mesh.youngs_modulus_kpa],
        "density_kg_m3": [mesh.density_kg_m3],
    }
    names = {int(value): _set_name(mesh.table, int(value)) for value in np.unique(mesh.label)}
    content = meshio.Mesh(mesh.points_mm, [("hexahedron", mesh.hexahedra)], point_data={"fixed": mesh.fixed})
    if suffix == ".inp":
        content.cell_sets = {name: [np.flatnonzero(mesh.label == value)] for value, name in names.items()}
        content.point_sets = {"FIXED": np.flatnonzero(mesh.fixed)} if mesh.fixed.any() else {}
    elif suffix == ".msh":
        tag = mesh.label.astype(np.int32)
        content.cell_data = cell_data | {"gmsh:physical": [tag], "gmsh:geometrical": [tag]}
        content.field_data = {name: np.array([value, 3]) for value, name in names.items()}
    else:
        content.cell_data = {"label": [mesh.label]} | cell_data
    return _written(content, suffix)


def _set_name(table: LabelTable, value: int) -> str:
    """A name that Abaqus takes: begins with a letter, no spaces, at most 80 characters (a label's name has 64)."""
    return re.sub(r"[^A-Z0-9]+", "_", f"TISSUE_{value}_{table[value].name}".upper()).strip("_")


def _written(mesh: meshio.Mesh, suffix: str) -> bytes:
    with tempfile.TemporaryDirectory(prefix="heartcase-") as directory:
        file = Path(directory) / f"mesh{suffix}"
        try:
            meshio.write(file, mesh, file_format=_FORMATS[suffix])
            content = file.read_bytes()
        except OSError:
            raise UsageError("the mesh cannot be written: is the disk full?", place="--out") from None
    # meshio names Abaqus' hybrid hexahedron with reduced integration, which other codes do not know
    return content.replace(b"TYPE=C3D8RH\n", b"TYPE=C3D8\n", 1) if suffix == ".inp" else content
