"""``heartcase export``: write parts of a case in the formats of other programs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from heartcase.cli.output import echo_json, file_size, working
from heartcase.schemas.bundle import CaseManifest, FileRole
from heartcase.schemas.errors import BundleError, UsageError
from heartcase.schemas.files import atomic_write

if TYPE_CHECKING:
    from heartcase.pipeline.data import Segmentation
    from heartcase.pipeline.formats.dicom_source import SourceSeries

__all__ = ["WRITERS", "command"]


@dataclass(frozen=True)
class _Export:
    """What the writers take."""

    case: Path
    manifest: CaseManifest
    scan: Path | None
    series: str | None

    @property
    def case_id(self) -> str:
        """The case's made-up identifier; of older cases, which have none, a part of the scan's hash."""
        return self.manifest.case_id or f"CASE-{self.manifest.scan_sha256[:12].upper()}"

    def labels(self) -> Segmentation:
        """The case's labels, grown walls included."""
        import numpy as np

        from heartcase.pipeline.data import Segmentation
        from heartcase.pipeline.read import read_labels

        entry = self.manifest.file(FileRole.LABELS)
        if entry is None:
            raise UsageError("the case was made without labels: add 'labels' to parts, and build again", place="CASE")
        volume = read_labels(self.case / entry.name)
        unknown = set(np.unique(volume.values).tolist()) - set(self.manifest.labels.values)
        if unknown or volume.values.dtype != np.uint8:
            raise BundleError("the labels hold values that are not in the case's table: build it again", place="CASE")
        return Segmentation(volume.values.astype(np.uint8), volume.geometry, self.manifest.labels)

    def source(self, labels: Segmentation) -> SourceSeries | None:
        """The DICOM series that the case was made from, where the user gives it."""
        from heartcase.pipeline.formats.dicom_source import find_source

        if self.scan is None:
            return None
        if not labels.geometry.matches(self.manifest.scan_geometry):
            raise BundleError("the labels do not lie on the lattice of the case's scan: build it again", place="CASE")
        return find_source(self.scan, self.manifest, series=self.series)


def _seg_nrrd(export: _Export) -> bytes:
    from heartcase.pipeline.write import segmentation_nrrd_bytes

    labels = export.labels()
    source = export.source(labels)
    return segmentation_nrrd_bytes(labels, case_id=export.case_id, offset=source.offset if source else (0, 0, 0))


def _dicom_seg(export: _Export) -> bytes:
    from heartcase.pipeline.formats.write_dicom_seg import dicom_seg_bytes

    labels = export.labels()
    return dicom_seg_bytes(labels, case_id=export.case_id, source=export.source(labels))


def _values(suffix: str) -> Callable[[_Export], bytes]:
    def write(export: _Export) -> bytes:
        from heartcase.pipeline.write import label_values_bytes

        return label_values_bytes(export.labels(), suffix)

    return write


WRITERS: dict[str, Callable[[_Export], bytes]] = {
    ".seg.nrrd": _seg_nrrd,
    ".dcm": _dicom_seg,
    ".nii.gz": _values(".nii.gz"),
    ".nrrd": _values(".nrrd"),
}
"""Ending of the file name -> what makes the file's content; the first that fits counts."""

_WITH_SCAN = (".seg.nrrd", ".dcm")


@click.command()
@click.argument("case", type=click.Path(path_type=Path, readable=False))
@click.option(
    "-o",
    "--out",
    "output",
    type=click.Path(path_type=Path, readable=False),
    required=True,
    help="The file to write: .seg.nrrd or .dcm (DICOM SEG) with names, colours and codes; .nii.gz or .nrrd with the "
    "label values alone.",
)
@click.option(
    "--scan",
    type=click.Path(path_type=Path, readable=False),
    help="The DICOM folder that the case was made from, so that the labels open on it; a scan with other values is "
    "refused. A .dcm then holds the scan's own study, series, image and frame of reference UIDs, which lead back to "
    "the patient.",
)
@click.option(
    "--series",
    help="Which series of --scan, where the same scan is there twice: by its number or code in 'heartcase info'.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object about the file.")
@working("exporting")
def command(case: Path, output: Path, scan: Path | None, series: str | None, as_json: bool) -> None:
    """Write the labels of CASE for another program.

    Nothing of the patient is in the file: the case's made-up identifier takes the place of name and number, and dates
    are empty or fixed. Only with --scan are UIDs of the scan written.
    """
    from heartcase.schemas.bundle_reader import open_bundle

    suffix = next((ending for ending in WRITERS if output.name.lower().endswith(ending)), None)
    if suffix is None:
        raise UsageError(f"the file must end in one of: {', '.join(WRITERS)}", place="--out")
    if scan is not None and suffix not in _WITH_SCAN:
        raise UsageError(f"serves only for {' and '.join(_WITH_SCAN)}: leave it out", place="--scan")
    content = WRITERS[suffix](_Export(case, open_bundle(case).manifest, scan, series))
    try:
        atomic_write(output, content)
    except OSError as error:
        raise UsageError(f"cannot be written: {error.strerror}", place="--out") from None
    if as_json:
        echo_json({"format": suffix, "bytes": len(content)})
    else:
        click.echo(f"wrote the labels, {file_size(len(content))}")
