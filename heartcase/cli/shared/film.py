"""Pictures and animations of a session, drawn without a screen."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from heartcase.schemas.arrays import Float32, Float64, Int32, UInt8
from heartcase.schemas.errors import MissingExtraError, UsageError
from heartcase.schemas.files import atomic_write
from heartcase.simulator.patching.sewn_mesh import SewnMesh, sewn_mesh
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.surface.deform import DeformedSurface

__all__ = [
    "ANIMATION_FORMATS",
    "CUT_FACE_COLOUR",
    "Filmer",
    "Seen",
    "animation_bytes",
    "check_animation_name",
    "check_picture_name",
    "write_animation",
    "write_picture",
]


ANIMATION_FORMATS = (".gif", ".mp4")
"""What an animation can be written as."""
PICTURE_FORMATS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG"}
"""What a picture can be written as: suffix -> Pillow's name."""

CUT_FACE_COLOUR = (150, 40, 45)
"""Red, green, blue of walls that a blade made."""
_FROM_LEFT_FRONT = (0.45, -1.0, 0.25)
"""Direction from the heart to the camera, LPS: front, somewhat left and above."""
_AROUND = 1.3
"""What of the heart is in the frame of some blades: as far across as their ends lie apart, times this."""
_NEAR_BLADE = 2.0
"""Tissue that says which way a blade goes in: as far from its middle as it reaches, times this."""


@dataclass(frozen=True)
class Seen:
    """What is seen of a simulation at a moment."""

    surface: DeformedSurface
    """The visible surface."""
    triangles: Int32
    """Vertex numbers, shape (triangle_count, 3)."""
    colours: UInt8
    """Red, green, blue of each triangle, shape (triangle_count, 3)."""
    sewn: SewnMesh
    """Patches and threads."""

    @classmethod
    def now(cls, simulation: Simulation, colours: UInt8) -> Seen:
        """What is seen now; ``colours`` are those of the surface before any cut."""
        assert simulation.surface is not None
        split = simulation.split
        carried = colours if split is None else split.carried(colours, CUT_FACE_COLOUR)
        sewn = sewn_mesh(
            [simulation.patch_state(patch) for patch in simulation.patches],
            [simulation.stitch_state(stitch) for stitch in simulation.stitches],
        )
        return cls(simulation.surface_now(), simulation.surface.triangles, carried, sewn)


class Filmer:
    """Takes pictures of a deforming surface from one place, each triangle in its structure's colour.

    Parameters
    ----------
    rest_mm
        Vertices at rest, LPS mm, shape (vertex_count, 3): they set the frame.
    size
        Width and height in pixels; whole multiples of 16 for MP4.
    blades_mm
        Where blades go, LPS mm, each of shape (pose_count, point_count, 3): where there are some, they set the frame
        and the camera stands where they came from.

    Raises
    ------
    MissingExtraError
        What draws is not installed.
    """

    def __init__(
        self, rest_mm: Float32, *, size: tuple[int, int] = (720, 608), blades_mm: Sequence[Float64] = ()
    ) -> None:
        try:
            import PIL.Image  # noqa: F401

            from heartcase.pipeline.report.render import camera_for
        except ImportError:
            raise MissingExtraError("A picture or an animation", "prepare") from None
        self.frames: list[UInt8] = []
        centre = (rest_mm.min(axis=0) + rest_mm.max(axis=0)) / 2
        # Room for the tissue that a hand pulls out of the frame of the tissue at rest.
        roomy = centre + 1.25 * (np.asarray(rest_mm, dtype=float) - centre)
        shown, towards = (roomy, _FROM_LEFT_FRONT) if not blades_mm else _above(blades_mm, rest_mm)
        up = (0.0, 0.0, 1.0) if abs(towards[2]) < 0.98 else (0.0, -1.0, 0.0)
        self.camera = camera_for(shown, towards=towards, up=up, size=size, margin=0.02)

    def take(self, seen: Seen) -> UInt8:
        """A picture, shape (height, width, 3)."""
        from heartcase.pipeline.report.render import Mesh, draw_mesh

        points = np.concatenate([seen.surface.vertices_mm.astype(float), seen.sewn.vertices_mm])
        normals = np.concatenate([seen.surface.normals.astype(float), seen.sewn.normals])
        own = seen.sewn.triangles + len(seen.surface.vertices_mm)
        triangles = np.concatenate([seen.triangles.astype(np.int64), own])
        mesh = Mesh(points, triangles, normals, np.concatenate([seen.colours, seen.sewn.colours]))
        return draw_mesh(mesh, self.camera, depth_shading=True)

    def film(self, seen: Seen) -> None:
        """Keep a picture as the next frame."""
        self.frames.append(self.take(seen))


def _above(blades_mm: Sequence[Float64], rest_mm: Float32) -> tuple[Float64, tuple[float, float, float]]:
    """Corners of a box around the outer ends of some blades, and the direction that they came from."""
    ends = [_ends(np.asarray(blade, dtype=float), rest_mm) for blade in blades_mm]
    outer, inner = (np.concatenate([one[which] for one in ends]) for which in (0, 1))
    towards = (outer - inner).mean(axis=0)
    length = float(np.linalg.norm(towards))
    x, y, z = towards / length if length > 1e-6 else _FROM_LEFT_FRONT
    half = _AROUND * max(float(np.ptp(outer, axis=0).max()), 1.0) / 2
    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    return (outer.min(axis=0) + outer.max(axis=0)) / 2 + half * corners, (float(x), float(y), float(z))


def _ends(blade_mm: Float64, rest_mm: Float32) -> tuple[Float64, Float64]:
    """Outer and inner ends of a blade, LPS mm, shape (count, 3) each.

    It goes in along its edge, as a knife is led along a line, or from pose to pose, as a line is pushed to its depth:
    whichever leads the straighter into the tissue around it.
    """
    middle = blade_mm.mean(axis=(0, 1))
    reach = np.linalg.norm(blade_mm - middle, axis=2).max()
    tissue = rest_mm[np.linalg.norm(rest_mm - middle, axis=1) <= _NEAR_BLADE * reach]
    outward = middle - (tissue if len(tissue) else rest_mm).mean(axis=0)

    def straightness(ends: tuple[Float64, Float64]) -> float:
        way = (ends[0] - ends[1]).mean(axis=0)
        return float(way @ outward) / max(float(np.linalg.norm(way)), 1e-6)

    sides = (blade_mm[:, 0], blade_mm[:, -1]), (blade_mm[0], blade_mm[-1])
    return max((ends for first, last in sides for ends in ((first, last), (last, first))), key=straightness)


def write_picture(path: Path | str, picture: UInt8, *, comment: str = "") -> None:
    """Write a picture, whole or not at all; the suffix says the format (``.png``, ``.jpg``).

    The comment goes into the file's own comment field: the case's identifier belongs there.

    Raises
    ------
    UsageError
        The suffix is none of these.
    """
    from PIL import Image

    from heartcase.pipeline.report.montage import png_bytes

    path = Path(path)
    check_picture_name(path)
    kind = PICTURE_FORMATS[path.suffix.lower()]
    if kind == "PNG":
        atomic_write(path, png_bytes(picture, comment=comment))
        return
    data = io.BytesIO()
    Image.fromarray(picture).save(data, format=kind, comment=comment.encode())
    atomic_write(path, data.getbuffer())


def write_animation(path: Path | str, frames: list[UInt8], *, frames_per_second: float, comment: str = "") -> None:
    """Write frames as a GIF that repeats, or as MP4 where imageio and its ffmpeg are installed.

    The comment goes into the file's own comment field: the case's identifier belongs there.

    Raises
    ------
    UsageError
        The suffix is neither, or MP4 cannot be written here.
    """
    path = Path(path)
    check_animation_name(path)
    atomic_write(path, animation_bytes(path.suffix.lower(), frames, frames_per_second, comment))


def animation_bytes(suffix: str, frames: list[UInt8], frames_per_second: float, comment: str = "") -> bytes:
    """The file of an animation, ``.gif`` or ``.mp4``; see :func:`write_animation`."""
    return (_gif if suffix == ".gif" else _mp4)(frames, frames_per_second, comment)


def check_animation_name(path: Path) -> None:
    """Refuse a name that no animation can be written to, before any work is done.

    Raises
    ------
    UsageError
        The suffix is neither ``.gif`` nor ``.mp4``, or MP4 cannot be written here.
    """
    suffix = path.suffix.lower()
    if suffix not in ANIMATION_FORMATS:
        raise UsageError(f"an animation is written as {' or '.join(ANIMATION_FORMATS)}; {path.name!r} is neither")
    if suffix == ".mp4":
        _imageio()


def check_picture_name(path: Path) -> None:
    """Refuse a name that no picture can be written to, before any work is done.

    Raises
    ------
    UsageError
        The suffix is not a picture's.
    """
    if path.suffix.lower() not in PICTURE_FORMATS:
        raise UsageError(f"a picture is written as {', '.join(PICTURE_FORMATS)}; {path.name!r} is none of these")


def _gif(frames: list[UInt8], frames_per_second: float, comment: str) -> bytes:
    from PIL import Image

    # Median cut would leave out what covers little, such as a line that marks a rim.
    method, dither = Image.Quantize.MAXCOVERAGE, Image.Dither.NONE
    pictures = [Image.fromarray(frame).quantize(256, method, dither=dither) for frame in frames]
    data = io.BytesIO()
    # A GIF counts hundredths of a second, and viewers slow down what is shorter than two of them.
    duration = 10 * max(2, round(100 / frames_per_second))
    told = {"comment": comment.encode()} if comment else {}
    pictures[0].save(data, format="GIF", save_all=True, append_images=pictures[1:], duration=duration, loop=0, **told)
    return data.getvalue()


def _mp4(frames: list[UInt8], frames_per_second: float, comment: str) -> bytes:
    written: bytes = _imageio().imwrite(
        "<bytes>",
        np.stack(frames),
        extension=".mp4",
        plugin="FFMPEG",
        fps=frames_per_second,
        output_params=["-metadata", f"comment={comment}"],
    )
    return written


def _imageio() -> Any:
    try:
        import imageio.v3
        import imageio_ffmpeg  # noqa: F401
    except ImportError:
        raise UsageError(
            "MP4 needs two more packages: run  pip install imageio imageio-ffmpeg  or ask for .gif"
        ) from None
    return imageio.v3
