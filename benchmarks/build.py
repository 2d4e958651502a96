"""The whole way, from a scan and a recipe to a case: everything anew, and again when nothing changed."""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.phantom_inputs import phantom_inputs
from heartcase.phantom.drawing.recipe import recipe_text
from heartcase.pipeline.building.run import BuildResult, build_case
from heartcase.pipeline.formats.write_images import write_scan
from heartcase.schemas.bundle.check import check_bundle
from heartcase.schemas.recipe.recipe import load_recipe


@dataclass(frozen=True)
class Inputs:
    """A directory with scan and recipe."""

    directory: Path
    force: bool


def prepare(params: dict[str, Any]) -> Inputs:
    force = params.pop("force")
    directory = Path(tempfile.mkdtemp(prefix="heartcase-benchmark-build-"))
    write_inputs(params, directory)
    return Inputs(directory, force)


def write_inputs(params: dict[str, Any], directory: Path) -> None:
    source = phantom_inputs(params)
    directory.mkdir(parents=True, exist_ok=True)
    write_scan(source.scan, directory / "scan.nii.gz")
    text = recipe_text(
        source.phantom, name="bench", scan_path="scan.nii.gz", command="heartcase bench build", modality="MR"
    )
    (directory / "recipe.toml").write_text(text, encoding="utf-8")


def build_phantom(params: dict[str, Any], directory: Path) -> Path:
    """Build the phantom's case in a directory, and give its path."""
    write_inputs(params, directory)
    heartcase(Inputs(directory, force=False))
    return directory / "bench.case"


def heartcase(inputs: Inputs) -> BuildResult:
    recipe = load_recipe(inputs.directory / "recipe.toml")
    return build_case(recipe, directory=inputs.directory, out=inputs.directory, force=inputs.force)


METHODS = {"heartcase": heartcase}


def errors(inputs: Inputs, output: BuildResult) -> dict[str, float]:
    """Problems of the case that was built, and seconds of each stage."""
    problems = check_bundle(inputs.directory / "bench.case")
    shutil.rmtree(inputs.directory)
    return {"problems of the case [1]": float(len(problems))} | {
        f"{stage} [s]": seconds for stage, seconds in output.seconds.items()
    }
