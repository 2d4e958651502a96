"""An animation of a recording: it is repeated, checked, and its surface shown at so many frames a second."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from heartcase.cli.shared.film import Filmer, Seen, animation_bytes, check_animation_name
from heartcase.schemas.arrays import Float32, Int32, UInt8
from heartcase.schemas.recording.reader import open_recording
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.load import Case, load_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.replay import check_frame_count, frame_steps, load_session, refuse_deviation

if TYPE_CHECKING:
    from heartcase.pipeline.exports.animation import MovingSurface

__all__ = ["Animation", "animation_of"]


@dataclass(frozen=True)
class Animation:
    """A file that is ready to be written."""

    content: bytes
    what: str
    """What it holds, in words."""
    facts: dict[str, object]
    """What --json adds."""
    warnings: tuple[str, ...] = ()


def animation_of(
    recording: Path,
    case: Path,
    suffix: str,
    *,
    level: int,
    frames_per_second: float,
    error_mm: float,
    is_partial: bool = False,
) -> Animation:
    """The file of a recording in motion.

    Parameters
    ----------
    recording, case
        The recording, and the case that was recorded.
    suffix
        ``.glb``, ``.gif`` or ``.mp4``.
    level
        Level of detail of the surface.
    frames_per_second
        Frames in a second of simulated time.
    error_mm
        How far a vertex of a GLB may be off in a frame, mm.
    is_partial
        Whether one that was cut short or damaged is shown as far as it is whole.

    Raises
    ------
    HeartcaseError
        The recording is not whole, of another case, or does not come to what was recorded; it is too long; or what
        writes the format is not installed.
    """
    if suffix != ".glb":
        check_animation_name(Path(f"animation{suffix}"))
    opened = open_recording(recording, partial=is_partial)
    check_frame_count(opened, frames_per_second)
    loaded = load_case(case, needs=("surface", "colours", "tissue"), level=level)
    tissue = loaded.tissue if opened.header.tissue_sha256 else TissueSamples.everywhere()
    session = load_session(opened, loaded.model, surface=loaded.surface, tissue=tissue)
    if suffix == ".glb":
        made = _glb(session, loaded, frames_per_second, error_mm)
    else:
        made = _film(session, loaded, suffix, frames_per_second)
    warning = opened.partial_warning
    return made if warning is None else replace(made, warnings=(str(warning),))


def _film(session: OperatingSession, case: Case, suffix: str, frames_per_second: float) -> Animation:
    assert case.surface is not None
    assert case.triangle_colours is not None
    camera = Filmer(case.surface.rest_mm)
    for _, seen in _frames(session, case.triangle_colours, frames_per_second):
        camera.film(seen)
    comment = f"heartcase {case.manifest.case_id}" if case.manifest.case_id else "heartcase"
    content = animation_bytes(suffix, camera.frames, frames_per_second, comment)
    facts: dict[str, object] = {"frame_count": len(camera.frames), "frames_per_second": frames_per_second}
    return Animation(content, f"{len(camera.frames)} frames", facts)


def _glb(session: OperatingSession, case: Case, frames_per_second: float, error_mm: float) -> Animation:
    from heartcase.pipeline.exports.animation import animation_glb_bytes

    assert case.triangle_colours is not None
    tissue: list[_Shown] = []
    sewn: list[_Shown] = []
    for time_s, seen in _frames(session, case.triangle_colours, frames_per_second):
        shown = seen.surface
        tissue.append(_Shown(time_s, shown.vertices_mm, shown.normals, seen.triangles, seen.colours))
        own = seen.sewn
        vertices, normals = own.vertices_mm.astype(np.float32), own.normals.astype(np.float32)
        sewn.append(_Shown(time_s, vertices, normals, own.triangles.astype(np.int32), own.colours))
    moving = [*_moving(tissue), *_moving(sewn)]
    content, error = animation_glb_bytes(moving, tolerance_mm=error_mm, case_id=case.manifest.case_id)
    count = len(tissue)
    facts: dict[str, Any] = {"frame_count": count, "frames_per_second": frames_per_second, "error_mm": error}
    return Animation(content, f"{count} frames, at most {error:.2g} mm off,", facts)


@dataclass(frozen=True)
class _Shown:
    """A mesh in a frame: of the tissue, or of what is sewn."""

    time_s: float
    vertices_mm: Float32
    normals: Float32
    triangles: Int32
    colours: UInt8

    def goes_on(self, before: _Shown) -> bool:
        """Whether it is the mesh of the frame before, moved."""
        return len(self.vertices_mm) == len(before.vertices_mm) and all(
            np.array_equal(one, other)
            for one, other in ((self.triangles, before.triangles), (self.colours, before.colours))
        )


def _moving(frames: list[_Shown]) -> list[MovingSurface]:
    """The meshes of some frames, each as long as it goes on; frames without triangles have none."""
    from heartcase.pipeline.exports.animation import MovingSurface

    # A cut makes another mesh, and so does what is sewn; it goes on where the one before ends.
    runs: list[list[_Shown]] = []
    for frame in frames:
        if not runs or not frame.goes_on(runs[-1][-1]):
            runs.append([])
        runs[-1].append(frame)
    ends = [*(run[0].time_s for run in runs[1:]), np.inf]
    return [
        MovingSurface(
            time_s=np.array([frame.time_s for frame in run]),
            vertices_mm=np.stack([frame.vertices_mm for frame in run]),
            normals=np.stack([frame.normals for frame in run]),
            triangles=run[0].triangles,
            colours=run[0].colours,
            until_s=end,
        )
        for run, end in zip(runs, ends, strict=True)
        if len(run[0].triangles)
    ]


def _frames(session: OperatingSession, colours: UInt8, frames_per_second: float) -> Iterator[tuple[float, Seen]]:
    """Time since the start and surface of each frame; at the end, the session is checked against what was recorded."""
    step_s, start = session.simulation.step_s, session.start_step
    yield 0.0, Seen.now(session.simulation, colours)
    for step in frame_steps(session, frames_per_second):
        for _ in session.play(step):
            pass
        yield (step - start) * step_s, Seen.now(session.simulation, colours)
    for _ in session.play():
        pass
    refuse_deviation(session)
