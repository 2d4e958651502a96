"""What a reader of DICOM meets, as data: how each situation is written, and what must come of it.

``python -m tests.pipeline.formats.dicom_situations`` prints the table of docs/dicom.md.
"""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from heartcase.pipeline.data import Scan
from heartcase.pipeline.formats.read_scan import read_scan
from heartcase.schemas.errors import ScanError
from heartcase.schemas.geometry import Geometry
from tests.pipeline.formats.dicom_series import write_series

__all__ = ["GEOMETRY", "STORED", "Outcome", "Situation", "Truth", "all_situations", "outcome_of", "table", "write"]

DIRECTION = np.array([[0.8, -0.36, 0.48], [0.6, 0.48, -0.64], [0.0, 0.8, 0.6]])
GEOMETRY = Geometry.of(
    shape=(9, 36, 34), origin_mm=(-81.25, 33.5, 410.0), spacing_mm=(1.25, 1.5, 2.0), direction=DIRECTION
)
"""Oblique, anisotropic, pixels that are not square."""
PLANTED = "Sensitivus"


def _stored() -> np.ndarray:
    """A heart's two blood pools in muscle as smooth bumps, and noise so that no two slices are alike."""
    k, j, i = np.indices(GEOMETRY.shape)
    pools = [(4.0, 15.0, 11.0, 5.0), (4.5, 19.0, 21.0, 6.0)]
    field_ = sum(
        600.0 * np.exp(-(((k - c) / 3) ** 2 + ((j - b) / r) ** 2 + ((i - a) / r) ** 2)) for c, b, a, r in pools
    )
    return (300.0 + field_ + np.random.default_rng(7).uniform(0.0, 60.0, GEOMETRY.shape)).astype(np.uint16)


STORED = _stored()
"""Stored values of most series, uint16, shape (9, 36, 34), 300 to 1,300."""


@dataclass(frozen=True)
class Truth:
    """What was written."""

    values: np.ndarray
    """Modality values, shape (slices, rows, columns)."""
    affine: np.ndarray = field(default_factory=lambda: GEOMETRY.affine)
    """Map from index (i, j, k, 1) to LPS mm."""
    loss: float = 0.0
    """Largest error of a value that the compression may have made."""
    place_mm: float = 1e-4
    """Largest error of a corner's place that the header's digits may have made."""


@dataclass(frozen=True)
class Situation:
    """One line of the table."""

    name: str
    """What the folder holds."""
    write: Callable[[Path], Truth | None]
    """Writes it into a folder that is not there yet; the truth, where it is to be read."""
    options: dict[str, Any] = field(default_factory=dict)
    """Options of ``read_scan``."""
    refused: str = ""
    """Pattern in the error; empty where it is to be read."""
    warns: str = ""
    """Pattern in the scan's warnings; empty where there must be none."""
    file: str = ""
    """File to give instead of the folder."""
    lines: int = 1
    """Lines of the error: more where it lists the choices."""
    has_acquisition: dict[str, float] = field(default_factory=dict)
    """What the scan's acquisition must hold."""


@dataclass(frozen=True)
class Outcome:
    """What came of it."""

    truth: Truth | None
    """What was written."""
    scan: Scan | None
    """What was read, or None."""
    problems: tuple[str, ...]
    """Lines of the error."""


def write(folder: Path, stored: np.ndarray = STORED, geometry: Geometry = GEOMETRY, **options: Any) -> list[Path]:
    """Write a plain series of a stack at a geometry, its files in an order that says nothing."""
    positions = geometry.index_to_world([(0, 0, k) for k in range(len(stored))])
    order = np.random.default_rng(3).permutation(len(stored))
    defaults: dict[str, Any] = {
        "orientation": direction_cosines(geometry),
        "pixel_spacing": (geometry.spacing_mm[1], geometry.spacing_mm[0]),
        "modality": "MR",
        "order": order,
        "PatientName": f"{PLANTED}^Anna",
        "SeriesDescription": PLANTED,
        "PatientBirthDate": "19770203",
    }
    return write_series(folder, stored, options.pop("positions", positions), **defaults | options)


def direction_cosines(geometry: Geometry) -> list[float]:
    """Direction of a row, then of a column."""
    return [*geometry.direction_matrix[:, 0], *geometry.direction_matrix[:, 1]]


def outcome_of(situation: Situation, folder: Path) -> Outcome:
    """Write a situation into a folder and read it."""
    target = folder / f"{PLANTED}_scan"
    target.mkdir()
    truth = situation.write(target)
    try:
        return Outcome(truth, read_scan(target / situation.file, **situation.options), ())
    except ScanError as error:
        return Outcome(truth, None, tuple(str(problem) for problem in error.problems))


def all_situations() -> tuple[Situation, ...]:
    """Every situation: how images are stored, which belong together, where headers disagree, what is refused."""
    from tests.pipeline.formats import (
        dicom_situations_damaged,
        dicom_situations_doubtful,
        dicom_situations_mixed,
        dicom_situations_read,
        dicom_situations_refused,
        dicom_situations_stacks,
    )

    return (
        *dicom_situations_read.SITUATIONS,
        *dicom_situations_stacks.SITUATIONS,
        *dicom_situations_mixed.SITUATIONS,
        *dicom_situations_refused.SITUATIONS,
        *dicom_situations_doubtful.SITUATIONS,
        *dicom_situations_damaged.SITUATIONS,
    )


OPTION_WORDS = {
    "series": "--series {}",
    "trigger_time_ms": "--trigger-time {:g}",
    "echo_time_ms": "--echo-time {:g}",
    "interpolate_missing": "--interpolate-missing",
    "straighten_tilt": "--straighten-tilt",
    "overlap": "--overlap {}",
    "frame": "--frame {}",
}


def command_line(options: dict[str, Any]) -> list[str]:
    """The options as they are typed."""
    return " ".join(OPTION_WORDS[name].format(value) for name, value in options.items()).split()


def _row(situation: Situation, outcome: Outcome) -> str:
    option = " ".join(command_line(situation.options))
    if outcome.scan is None:
        said = outcome.problems[0].removeprefix("scan: ")
        said += " ... and the list" if len(outcome.problems) > 1 else ""
        return f"| {situation.name} | {f'`{option}`' if option else ''} | refused | {said} |"
    loss = outcome.truth.loss if outcome.truth else 0.0
    values = f"values within {loss:.3g}" if loss else "values exact"
    said = "; ".join((values, *(warning.text for warning in outcome.scan.warnings)))
    return f"| {situation.name} | {f'`{option}`' if option else ''} | read | {said} |"


def table(outcomes: dict[str, Outcome] | None = None) -> str:
    """The table as Markdown; ``outcomes`` by name, where they are known."""
    rows = []
    for situation in all_situations():
        if outcomes is not None and situation.name in outcomes:
            outcome = outcomes[situation.name]
        else:
            with tempfile.TemporaryDirectory() as folder:
                outcome = outcome_of(situation, Path(folder))
        rows.append(_row(situation, outcome))
    read = sum("| read |" in row for row in rows)
    head = [
        f"{len(rows)} situations: {read} read, {len(rows) - read} refused.",
        "",
        "| situation | options | outcome | what heartcase says |",
        "|---|---|---|---|",
    ]
    return "\n".join([*head, *rows]) + "\n"


@functools.cache
def frames_of_itk(stored_bytes: bytes, shape: tuple[int, ...]) -> tuple[bytes, ...]:
    """Frames of a uint16 volume as lossless JPEG (process 14), by the encoder inside SimpleITK."""
    import pydicom
    import SimpleITK
    from pydicom.encaps import generate_frames

    frames = []
    with tempfile.TemporaryDirectory() as folder:
        for plane in np.frombuffer(stored_bytes, np.uint16).reshape(shape):
            writer = SimpleITK.ImageFileWriter()
            writer.SetImageIO("GDCMImageIO")
            writer.SetFileName(str(Path(folder) / "x.dcm"))
            writer.UseCompressionOn()
            writer.SetCompressor("JPEG")
            writer.Execute(SimpleITK.GetImageFromArray(plane[np.newaxis]))
            dataset = pydicom.dcmread(Path(folder) / "x.dcm")
            frames.append(next(generate_frames(dataset.PixelData, number_of_frames=1)))
    return tuple(frames)


if __name__ == "__main__":
    print(table(), end="")
