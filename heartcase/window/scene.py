"""The actors of the window: heart, instruments, stitches, drawn line, slice, texts. PyVista draws them."""

from __future__ import annotations

from typing import Any

import numpy as np

from heartcase.schemas.arrays import Float64, Int32
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.live.live_frame import LiveFrame
from heartcase.simulator.live.shapes import Structures, grey_range, slice_corners_mm, slice_greys, stretch_colours
from heartcase.simulator.load import ScanVolume
from heartcase.simulator.surface.deform import SurfaceModel

__all__ = ["LIST_LEFT", "LIST_STEP", "LIST_TOP", "Scene"]

LIST_LEFT, LIST_TOP, LIST_STEP = 0.77, 0.97, 0.032
"""Where the list of structures stands: left edge, upper edge, height of a line, in parts of the window."""
_INSTRUMENT_COLOURS = {"grab": "gold", "forceps": "silver", "retractor": "deepskyblue", "scissors": "silver"}
_HANDLE_MM = 1.5
_SHADOW = 0.25


class Scene:
    """What is seen of a case in operation.

    Parameters
    ----------
    plotter
        PyVista's plotter, in which it is drawn.
    structures
        The structures, and which are hidden.
    scan
        The scan, where the case holds one.
    """

    def __init__(self, plotter: Any, structures: Structures, scan: ScanVolume | None) -> None:
        import pyvista

        self._pyvista = pyvista
        self.plotter = plotter
        self.structures = structures
        self.scan = scan
        self.slice_index: int | None = None
        self._greys = None if scan is None else grey_range(scan)
        self._triangles: Int32 = np.zeros((0, 3), np.int32)
        self._shown: Int32 = np.zeros(0, np.int32)
        self._looks: SurfaceModel | None = None
        self._heart: Any = None
        self._heart_actor: Any = None
        self._drawn: dict[str, Any] = {}
        self._texts: dict[str, Any] = {}
        self._over = self._make_over()
        self._fill_list()

    @property
    def pickable(self) -> Int32:
        """Numbers of the triangles that can be pointed at, shape (count,): those that are shown."""
        return self._shown

    def draw(self, live: LiveFrame, *, stretch: tuple[LatticeModel, Float64] | None, line_mm: Float64) -> None:
        """Show a moment.

        Parameters
        ----------
        live
            The moment.
        stretch
            Stretch of the tissue at nodes, and their lattice, where its colours are wanted.
        line_mm
            What is drawn on the tissue, LPS mm, shape (count, 3).
        """
        self._draw_heart(live, stretch)
        self._draw_instruments(live)
        self._draw_stitches(live)
        self._draw_patches(live)
        self._draw_line(line_mm)

    def show_slice(self, index: int | None) -> None:
        """Show a slice of the scan, with the heart opened at it; None shows none."""
        if self.scan is None:
            return
        self.slice_index = index
        self._looks = None
        self._remove("slice")
        if index is None:
            return
        assert self._greys is not None
        ni, nj, nk = self.scan.geometry.size
        self.slice_index = index = int(np.clip(index, 0, nk - 1))
        grid = self._pyvista.StructuredGrid()
        grid.points = slice_corners_mm(self.scan, index)
        grid.dimensions = (ni + 1, nj + 1, 1)
        grid.cell_data["grey"] = np.repeat(slice_greys(self.scan, index, self._greys)[:, None], 3, axis=1)
        self._drawn["slice"] = self.plotter.add_mesh(
            grid, scalars="grey", rgb=True, lighting=False, show_scalar_bar=False, reset_camera=False, name="slice"
        )

    def text(self, name: str, words: str, *, place: tuple[float, float], size: int = 10, colour: str = "black") -> None:
        """Write words, or others in place of those of the same name.

        Parameters
        ----------
        name
            Which text.
        words
            The words; none takes it away.
        place
            Its upper left corner, in parts of the window, right and up.
        size
            Height of the letters, points.
        colour
            Its colour.
        """
        if name not in self._texts:
            actor = self._pyvista.Text(words, position=None)
            actor.prop.font_family = "courier"
            actor.prop.justification_horizontal, actor.prop.justification_vertical = "left", "top"
            coordinate = actor.GetPositionCoordinate()
            coordinate.SetCoordinateSystemToNormalizedViewport()
            self.plotter.renderer.AddViewProp(actor)
            self._texts[name] = actor
        actor = self._texts[name]
        actor.input = words
        actor.prop.font_size = size
        actor.prop.color = colour
        actor.GetPositionCoordinate().SetValue(*place)
        actor.SetVisibility(bool(words))

    def listed(self, right: float, up: float) -> int | None:
        """The structure whose name stands at a place of the window, in parts of it; None where none does."""
        row = int((LIST_TOP - up) / LIST_STEP) if up <= LIST_TOP else -1
        return self.structures.all[row].number if right >= LIST_LEFT and 0 <= row < len(self.structures.all) else None

    def hidden_changed(self) -> None:
        """What is hidden is not the same any more."""
        self._looks = None
        self._fill_list()

    def _fill_list(self) -> None:
        for row, structure in enumerate(self.structures.all):
            is_hidden = structure.number in self.structures.hidden
            dark = tuple(int((1 - _SHADOW) * value) for value in structure.colour)
            self.text(
                f"structure {row}",
                f"{'-' if is_hidden else '+'} {structure.name.removeprefix('morphologically ')[:32]}",
                place=(LIST_LEFT, LIST_TOP - row * LIST_STEP),
                colour="darkgrey" if is_hidden else "#{:02x}{:02x}{:02x}".format(*dark),
            )

    def _draw_heart(self, live: LiveFrame, stretch: tuple[LatticeModel, Float64] | None) -> None:
        surface = live.frame.surface
        assert surface is not None
        # Triangles, structures and slice are looked at again only where they may have changed.
        if self._looks is not live.surface:
            self._make_heart(live)
            self._looks = live.surface
        self._heart.points = surface.vertices_mm
        self._heart.point_data.active_normals = surface.normals
        colours = None if stretch is None else stretch_colours(live, stretch)
        mapper = self._heart_actor.mapper
        if colours is None:
            mapper.SetScalarModeToUseCellFieldData()
            mapper.SelectColorArray("structure")
        else:
            self._heart.point_data["stretch"] = colours
            mapper.SetScalarModeToUsePointFieldData()
            mapper.SelectColorArray("stretch")

    def _make_heart(self, live: LiveFrame) -> None:
        surface = live.frame.surface
        assert surface is not None
        numbers = self.structures.of(live)
        is_shown = self.structures.is_shown(numbers)
        self._remove("heart")
        triangles = live.surface.triangles
        plane = None
        if self.slice_index is not None and self.scan is not None:
            # The heart is opened on the side of the slice from which the camera looks.
            geometry = self.scan.geometry
            at = geometry.index_to_world([[0.0, 0.0, float(self.slice_index)]])[0]
            normal = geometry.index_to_world([[0.0, 0.0, self.slice_index + 1.0]])[0] - at
            normal /= np.linalg.norm(normal)
            if (np.array(self.plotter.camera.position) - at) @ normal > 0.0:
                normal = -normal
            plane = (at, normal)
            middles = live.surface.rest_mm[triangles].mean(axis=1)
            is_shown &= (middles - at) @ normal > 0.0
        self._shown = np.flatnonzero(is_shown).astype(np.int32)
        chosen = np.flatnonzero(self.structures.is_shown(numbers))
        is_anything_shown = bool(len(chosen))
        if not is_anything_shown:
            chosen = np.arange(len(triangles))
        self._heart = self._pyvista.PolyData.from_regular_faces(surface.vertices_mm, triangles[chosen])
        self._heart.cell_data["structure"] = self.structures.colours(numbers[chosen])
        self._heart_actor = self.plotter.add_mesh(
            self._heart,
            scalars="structure",
            rgb=True,
            smooth_shading=False,
            show_scalar_bar=False,
            reset_camera=False,
            name="heart",
        )
        self._heart_actor.SetVisibility(is_anything_shown)
        self._heart_actor.prop.interpolation = "Phong"
        self._heart_actor.prop.ambient = 0.15
        self._heart_actor.prop.specular, self._heart_actor.prop.specular_power = 0.15, 20.0
        if plane is not None:
            from vtkmodules.vtkCommonDataModel import vtkPlane

            clip = vtkPlane()
            clip.SetOrigin(*plane[0])
            clip.SetNormal(*plane[1])
            self._heart_actor.mapper.AddClippingPlane(clip)
        self._drawn["heart"] = self._heart_actor

    def _draw_instruments(self, live: LiveFrame) -> None:
        there = set()
        for name, shown in live.frame.instruments.items():
            there.add(f"instrument {name}")
            if shown.kind == "probe":
                axes = live.probes[name]
                for end in (-1.0, 1.0) if axes[:, 3].any() else (0.0,):
                    part = f"instrument {name}" + (f" {end}" if end else "")
                    there.add(part)
                    matrix = np.eye(4)
                    matrix[:3, :3], matrix[:3, 3] = axes[:, :3], shown.center_mm + end * axes[:, 3]
                    self._place_ball(part, matrix, "seagreen")
                continue
            matrix = np.diag([_HANDLE_MM, _HANDLE_MM, _HANDLE_MM, 1.0])
            matrix[:3, 3] = shown.center_mm
            colour = _INSTRUMENT_COLOURS.get(shown.kind, "silver")
            self._place_ball(f"instrument {name}", matrix, colour, is_handle=True)
        for name in [name for name in self._drawn if name.startswith("instrument ") and name not in there]:
            self._remove(name)

    def _make_over(self) -> Any:
        """What is drawn over all else: handles of instruments, which may lie in the tissue."""
        from vtkmodules.vtkRenderingCore import vtkRenderer

        over = vtkRenderer()
        window = self.plotter.render_window
        window.SetNumberOfLayers(max(window.GetNumberOfLayers(), 2))
        over.SetLayer(1)
        over.InteractiveOff()
        over.SetActiveCamera(self.plotter.camera)
        window.AddRenderer(over)
        return over

    def _place_ball(self, name: str, matrix: Float64, colour: str, *, is_handle: bool = False) -> None:
        if name not in self._drawn:
            ball = self._pyvista.Sphere(radius=1.0, theta_resolution=24, phi_resolution=24)
            if is_handle:
                actor = self._pyvista.Actor(mapper=self._pyvista.DataSetMapper(ball))
                actor.prop.color, actor.prop.opacity, actor.prop.ambient = colour, 0.8, 0.4
                self._over.AddActor(actor)
                self._drawn[name] = actor
            else:
                self._drawn[name] = self.plotter.add_mesh(ball, color=colour, reset_camera=False, name=name)
        self._drawn[name].user_matrix = matrix

    def _draw_stitches(self, live: LiveFrame) -> None:
        stitches = list(live.frame.stitches.values())
        if not stitches:
            self._remove("stitches")
            return
        points = np.concatenate([stitch.places_mm for stitch in stitches]).astype(np.float32)
        lines, first = [], 0
        for stitch in stitches:
            count = len(stitch.places_mm)
            lines += [count, *range(first, first + count)]
            first += count
        self._draw_lines("stitches", points, np.array(lines), "black", 4.0)

    def _draw_patches(self, live: LiveFrame) -> None:
        there = set()
        for name, patch in live.frame.patches.items():
            there.add(f"patch {name}")
            sheet = self._pyvista.PolyData.from_regular_faces(patch.vertices_mm.astype(np.float32), patch.triangles)
            sheet.point_data.active_normals = patch.normals.astype(np.float32)
            if f"patch {name}" in self._drawn:
                self._drawn[f"patch {name}"].mapper.dataset = sheet
            else:
                self._drawn[f"patch {name}"] = self.plotter.add_mesh(
                    sheet, color="wheat", reset_camera=False, name=f"patch {name}"
                )
        for name in [name for name in self._drawn if name.startswith("patch ") and name not in there]:
            self._remove(name)

    def _draw_line(self, line_mm: Float64) -> None:
        count = len(line_mm)
        if not count:
            self._remove("line")
            return
        cells = np.concatenate([[count], np.arange(count)]) if count > 1 else np.array([1, 0])
        self._draw_lines("line", line_mm.astype(np.float32), cells, "crimson", 5.0, as_points=count == 1)

    def _draw_lines(
        self, name: str, points: Any, cells: Any, colour: str, width: float, *, as_points: bool = False
    ) -> None:
        data = self._pyvista.PolyData()
        data.points = points
        if as_points:
            data.verts = cells
        else:
            data.lines = cells
        if name in self._drawn:
            self._drawn[name].mapper.dataset = data
            return
        actor = self.plotter.add_mesh(
            data, color=colour, line_width=width, point_size=10.0, lighting=False, reset_camera=False, name=name
        )
        # In front of the tissue that it lies on.
        actor.mapper.SetRelativeCoincidentTopologyLineOffsetParameters(0.0, -8.0)
        actor.mapper.SetRelativeCoincidentTopologyPointOffsetParameter(-8.0)
        actor.mapper.SetResolveCoincidentTopologyToPolygonOffset()
        self._drawn[name] = actor

    def _remove(self, name: str) -> None:
        actor = self._drawn.pop(name, None)
        if actor is not None:
            self._over.RemoveActor(actor)
            self.plotter.remove_actor(actor, reset_camera=False, render=False)
