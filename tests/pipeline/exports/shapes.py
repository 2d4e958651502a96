"""Closed meshes of known size, as models."""

from __future__ import annotations

import numpy as np
import trimesh

from heartcase.pipeline.exports.models import TaggedMesh
from heartcase.schemas.labels import Label, LabelTable, Role

TABLE = LabelTable(
    labels=(
        Label(value=1, name="left ventricle", role=Role.BLOOD),
        Label(value=2, name="aorta", role=Role.VESSEL_LUMEN),
        Label(value=7, name="muscle", role=Role.MYOCARDIUM),
    )
)


def ball(radius_mm, centre=(0.0, 0.0, 0.0), *, fineness=4):
    mesh = trimesh.creation.icosphere(subdivisions=fineness, radius=radius_mm)
    mesh.apply_translation(centre)
    return mesh


def turned(mesh):
    """A hollow's face: the triangles the other way round."""
    return trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1], process=False)


def model(*parts, labels=None, table=TABLE):
    """A model of some meshes; part n beside cavity ``labels[n]``, and muscle (7) on the other side of all."""
    whole = trimesh.util.concatenate(list(parts))
    count = len(whole.faces)
    beside = [0] * len(parts) if labels is None else labels
    return TaggedMesh(
        vertices_mm=whole.vertices.astype(np.float32),
        normals=np.array(whole.vertex_normals, np.float32),
        triangles=whole.faces.astype(np.int32),
        triangle_label=np.repeat(np.array(beside, np.uint8), [len(part.faces) for part in parts]),
        triangle_tissue=np.full(count, 7, np.uint8),
        triangle_is_cut=np.zeros(count, np.uint8),
        table=table,
    )


def hollow_ball(shift_mm=2.0):
    """Radius 20 mm, with a hollow of 17 mm that is ``shift_mm`` to the left of its middle: a wall of 3 mm +- shift."""
    return model(ball(20.0), turned(ball(17.0, (shift_mm, 0.0, 0.0))), labels=[0, 1])
