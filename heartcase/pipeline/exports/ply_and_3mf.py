"""Models as PLY and 3MF: the same bytes for the same model."""

from __future__ import annotations

import io
import zipfile
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from heartcase.pipeline.exports.models import TaggedMesh
from heartcase.schemas import ply

__all__ = ["ply_bytes", "three_mf_bytes"]

_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_CONTENT_TYPES = """<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">
<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>
<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>
</Types>
"""
_RELATIONSHIPS = """<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Id="model" Target="/3D/3dmodel.model" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>
</Relationships>
"""
_FIRST_DATE = (1980, 1, 1, 0, 0, 0)


def ply_bytes(mesh: TaggedMesh, *, case_id: str) -> bytes:
    """Content of a binary PLY file, LPS mm, with normals.

    Each face has ``label``, ``tissue`` and ``is_cut`` (uchar) as :class:`TaggedMesh` has them, and its structure's
    colour. Comments name the labels, the case's made-up identifier and the axes.
    """
    comments = ["SPACE=LPS", f"patient LPS, mm; case {case_id}"]
    comments += [f"label {label.value} {label.name}" for label in mesh.table]
    tags = {"label": mesh.triangle_label, "tissue": mesh.triangle_tissue, "is_cut": mesh.triangle_is_cut}
    return ply.ply_bytes(mesh.vertices_mm, mesh.normals, mesh.triangles, mesh.colours, comments=comments, tags=tags)


def three_mf_bytes(mesh: TaggedMesh, *, title: str) -> bytes:
    """Content of a 3MF file (core specification 1.x), in mm.

    One object, so that no slicer moves its pieces apart; its coordinates are patient LPS. Each triangle has a base
    material with the name and colour of its structure. The build's one item moves the object to where all
    coordinates are positive, as printers want it.

    Parameters
    ----------
    mesh
        The model.
    title
        What it is, without anything of the patient.
    """
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, text in (
            ("[Content_Types].xml", _CONTENT_TYPES),
            ("_rels/.rels", _RELATIONSHIPS),
            ("3D/3dmodel.model", _model(mesh, title)),
        ):
            entry = zipfile.ZipInfo(name, _FIRST_DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 0
            archive.writestr(entry, text.encode())
    return stream.getvalue()


def _model(mesh: TaggedMesh, title: str) -> str:
    structures = mesh.structures
    place = np.zeros(256, np.int64)
    place[[label.value for label in structures]] = np.arange(len(structures))
    corners = np.column_stack([mesh.triangles, place[mesh.structure]]).tolist()
    shift = np.ceil(-mesh.vertices_mm.min(axis=0).astype(np.float64) * 1000.0) / 1000.0
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<model unit="millimeter" xml:lang="en-US" xmlns="{_CORE}">',
        f'<metadata name="Title">{escape(title)}</metadata>',
        '<metadata name="Application">heartcase</metadata>',
        '<metadata name="Description">Patient LPS, mm. Not a medical device.</metadata>',
        "<resources>",
        '<basematerials id="1">',
        *(
            f"<base name={quoteattr(label.name)} displaycolor={quoteattr(label.colour.upper() + 'FF')}/>"
            for label in structures
        ),
        "</basematerials>",
        f'<object id="2" type="model" pid="1" pindex="0" name={quoteattr(title)}>',
        "<mesh>",
        "<vertices>",
        *(f'<vertex x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/>' for x, y, z in mesh.vertices_mm.tolist()),
        "</vertices>",
        "<triangles>",
        *(f'<triangle v1="{a}" v2="{b}" v3="{c}" pid="1" p1="{p}"/>' for a, b, c, p in corners),
        "</triangles>",
        "</mesh>",
        "</object>",
        "</resources>",
        "<build>",
        '<item objectid="2" transform="1 0 0 0 1 0 0 0 1 {:.3f} {:.3f} {:.3f}"/>'.format(*shift),
        "</build>",
        "</model>",
    ]
    return "\n".join(lines) + "\n"
