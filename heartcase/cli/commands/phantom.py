"""``heartcase phantom``: a synthetic scan of a heart, with its truth and a recipe."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from heartcase.cli.shared.output import compiling_told, error_console
from heartcase.cli.shared.output_path import OutputPath
from heartcase.cli.shared.step_bar import StepBar
from heartcase.schemas.errors import UsageError
from heartcase.schemas.files import atomic_write

if TYPE_CHECKING:
    from heartcase.schemas.arrays import UInt8
    from heartcase.schemas.geometry import Geometry
    from heartcase.schemas.recipe.phantom_scan import PhantomScan

__all__ = ["command"]


class _SpacingCommand(click.Command):
    """Takes one number or three after ``--spacing``."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        gathered: list[str] = []
        rest = list(args)
        while rest:
            gathered.append(rest.pop(0))
            if gathered[-1] == "--spacing":
                numbers: list[str] = []
                while rest and len(numbers) < 3 and _is_number(rest[0]):
                    numbers.append(rest.pop(0))
                gathered += [",".join(numbers)] if numbers else []
        return super().parse_args(ctx, gathered)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _refuse_painted(recipe: Path) -> None:
    """Refuse to write over a recipe that somebody painted on."""
    from heartcase.pipeline.building.recipe_text import HEADING

    try:
        text = recipe.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return
    if HEADING.strip() in text.splitlines():
        raise UsageError(
            "its recipe.toml holds strokes that were painted in a session: choose another folder, or move it away",
            place=str(recipe.parent),
        )


@click.command(cls=_SpacingCommand, name="phantom")
@click.argument("out_dir", type=OutputPath(is_folder=True))
@click.option("--size", type=click.Choice(["adult", "child"]), default="adult", show_default=True, help="Which heart.")
@click.option(
    "--modality", type=click.Choice(["mri", "ct"]), default="mri", show_default=True, help="What kind of scan."
)
@click.option(
    "--spacing",
    default=None,
    metavar="MM [MM MM]",
    help="Voxel size: one number, or three for i, j, k. Left out: 1.75 for the adult, 1 for the child.",
)
@click.option(
    "--noise",
    type=float,
    default=None,
    metavar="CNR",
    help="Contrast to noise, (blood - myocardium) / sigma; 0 makes no noise. Left out: 14.5 (MRI), 8 (CT).",
)
@click.option("--bias", type=float, default=0.08, show_default=True, help="MRI: largest deviation of the sensitivity.")
@click.option("--seed", type=int, default=1, show_default=True, help="Seed of the noise.")
@click.option("--oblique", is_flag=True, help="Scan in the heart's short-axis plane.")
@click.option("--vsd", type=float, default=None, metavar="MM", help="Add a ventricular septal defect of this diameter.")
@click.option("--asd", type=float, default=None, metavar="MM", help="Add an atrial septal defect of this diameter.")
@click.option("--scan-only", is_flag=True, help="Write the scan alone, without truth and recipe.")
@click.option("--dicom", is_flag=True, help="Write the scan as a DICOM series too, into OUT_DIR/dicom.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
def command(
    out_dir: Path,
    size: str,
    modality: str,
    spacing: str | None,
    noise: float | None,
    bias: float,
    seed: int,
    oblique: bool,
    vsd: float | None,
    asd: float | None,
    scan_only: bool,
    dicom: bool,
    as_json: bool,
) -> None:
    """Make a synthetic scan of a heart of known shape.

    Writes scan.nii.gz, truth.nii.gz (true label of each voxel) and recipe.toml (strokes and end markers, ready for
    "heartcase build") into OUT_DIR. With --dicom there is also a series of DICOM files to choose in "heartcase studio".
    """
    from heartcase.library.scans import note_scan
    from heartcase.phantom.anatomy.heart import HeartPhantom
    from heartcase.phantom.drawing.recipe import recipe_text
    from heartcase.phantom.scan.acquisition import acquire_ct, acquire_mri
    from heartcase.pipeline.data import Scan, Segmentation
    from heartcase.pipeline.formats.write_dicom_series import check_series_folder, write_dicom_series
    from heartcase.pipeline.formats.write_images import write_scan, write_segmentation

    if dicom:
        # before anything is written over
        check_series_folder(out_dir / "dicom")
    if not scan_only:
        _refuse_painted(out_dir / "recipe.toml")
    voxel = _spacing(spacing, size)
    settings: dict[str, Any] = {"seed": seed}
    if noise is not None:
        if noise < 0.0:
            raise UsageError("the contrast to noise must be 0 (no noise) or above", place="--noise")
        settings["contrast_to_noise"] = noise if noise > 0.0 else float("inf")
    if modality == "mri":
        if not 0.0 <= bias < 1.0:
            raise UsageError("the bias must be at least 0 and below 1", place="--bias")
        settings["bias"] = bias
    holes = {name: _diameter(one, name) for name, one in (("vsd", vsd), ("asd", asd)) if one is not None}

    console = error_console()
    console.print(f"Making a scan of the {size} phantom")
    bar = StepBar(console)
    with bar.progress, compiling_told(console):
        phantom = HeartPhantom.of_size(size)
        with bar.step("building the heart") as told:
            phantom.prepare(told)
            defects = [
                phantom.ventricular_defect(one) if name == "vsd" else phantom.atrial_defect(one)
                for name, one in holes.items()
            ]
            if defects:
                phantom = HeartPhantom.of_size(size, defects=defects)
            geometry = phantom.scan_geometry(voxel, oblique=oblique)
        with bar.step("making the scan") as told:
            acquire = acquire_mri if modality == "mri" else acquire_ct
            scan = acquire(phantom, geometry, told=told, **settings)
        if not scan_only:
            with bar.step("labelling its voxels") as told:
                labels = _true_labels(phantom.truth.label, geometry, told)
            with bar.step("drawing strokes"):
                text = recipe_text(
                    phantom,
                    name="-".join([size, "phantom", *holes]),
                    scan_path="scan.nii.gz",
                    command=_command_line(size, modality, spacing, noise, bias, seed, oblique, vsd, asd),
                    modality=scan.modality,
                )

    # all is made before anything is written: who stops it finds no part of it
    _make_folder(out_dir)
    files = ["scan.nii.gz"]
    note_scan(out_dir / "scan.nii.gz", None)
    write_scan(Scan(scan.values, geometry, scan.modality), out_dir / "scan.nii.gz")
    same = None if defects else _as_settings(size, scan.modality, voxel, noise, bias, seed, oblique)
    note_scan(out_dir / "scan.nii.gz", same)
    if dicom:
        written = write_dicom_series(
            Scan(scan.values, geometry, scan.modality), out_dir / "dicom", name=f"{size} phantom"
        )
        files += [f"dicom/{path.name}" for path in written]
    summary: dict[str, Any] = {
        "size": size,
        "modality": scan.modality,
        "voxels": list(geometry.size),
        "spacing_mm": list(geometry.spacing_mm),
        "contrast_to_noise": scan.contrast_to_noise if np.isfinite(scan.contrast_to_noise) else None,
        "noise_sd": round(scan.noise_sd, 4),
        "seed": seed,
    }
    if not scan_only:
        write_segmentation(Segmentation(labels, geometry, phantom.truth.table), out_dir / "truth.nii.gz")
        atomic_write(out_dir / "recipe.toml", text.encode())
        files += ["truth.nii.gz", "recipe.toml"]
        table = phantom.truth.table
        counts = np.bincount(labels.ravel(), minlength=256)
        volume = geometry.voxel_volume_mm3 / 1000.0
        summary["volume_ml"] = {
            label.name: round(float(counts[label.value] * volume), 2) for label in table if label.value != 0
        }
        summary["tissue_ml"] = round(float(counts[list(table.tissue_values)].sum() * volume), 2)
    summary["files"] = files
    if as_json:
        click.echo(json.dumps(summary, indent=2))
        return
    extent = " x ".join(str(n) for n in geometry.size)
    step = " x ".join(f"{v:g}" for v in geometry.spacing_mm)
    click.echo(f"{scan.modality} of the {size} phantom: {extent} voxels of {step} mm, noise {scan.noise_sd:.3g}")
    if "tissue_ml" in summary:
        click.echo(f"tissue {summary['tissue_ml']:g} ml")
    shown = [name for name in files if not name.startswith("dicom/")]
    if dicom:
        shown.append(f"dicom ({len(files) - len(shown)} files)")
    click.echo(f"wrote {', '.join(shown)} into {out_dir}")


def _as_settings(
    size: str, modality: str, voxel: list[float], noise: float | None, bias: float, seed: int, oblique: bool
) -> PhantomScan | None:
    """What a recipe would say to have this scan made; None where it cannot be said."""
    from heartcase.schemas.recipe.phantom_scan import PhantomScan

    stated = {"heart": {"size": size}, "modality": modality, "spacing_mm": (voxel * 3)[:3], "seed": seed}
    try:
        return PhantomScan.model_validate(
            stated | {"is_oblique": oblique, "bias": bias} | ({} if noise is None else {"contrast_to_noise": noise})
        )
    except ValueError:
        return None


def _command_line(
    size: str,
    modality: str,
    spacing: str | None,
    noise: float | None,
    bias: float,
    seed: int,
    oblique: bool,
    vsd: float | None,
    asd: float | None,
) -> str:
    """The command that makes this very scan, for the recipe."""
    words = ["heartcase phantom THIS_FOLDER", f"--size {size}", f"--modality {modality}"]
    if spacing is not None:
        words.append(f"--spacing {spacing.replace(',', ' ')}")
    for name, value in (("noise", noise), ("vsd", vsd), ("asd", asd)):
        if value is not None:
            words.append(f"--{name} {value:g}")
    if modality == "mri":
        words.append(f"--bias {bias:g}")
    words.append(f"--seed {seed}")
    if oblique:
        words.append("--oblique")
    return " ".join(words)


def _spacing(text: str | None, size: str) -> list[float]:
    if text is None:
        return [1.75 if size == "adult" else 1.0]
    try:
        values = [float(part) for part in text.replace(",", " ").split()]
    except ValueError:
        values = []
    if len(values) not in (1, 3) or not all(0.2 <= value <= 20.0 for value in values):
        raise UsageError("give one voxel size or three, in mm, from 0.2 to 20", place="--spacing")
    return values


def _diameter(value: float, option: str) -> float:
    if not 0.0 < value <= 50.0:
        raise UsageError("give a diameter in mm, above 0 and up to 50", place=f"--{option}")
    return value


def _true_labels(label_of: Any, geometry: Geometry, told: Callable[[float], None]) -> UInt8:
    labels = np.empty(geometry.shape, np.uint8)
    j, i = np.indices(geometry.shape[1:])
    for k in range(geometry.shape[0]):
        labels[k] = label_of(geometry.index_to_world(np.stack([i, j, np.full_like(i, k)], axis=-1)))
        told((k + 1) / geometry.shape[0])
    return labels


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        raise UsageError("the folder cannot be made: check the path and its permissions", place="OUT_DIR") from None
