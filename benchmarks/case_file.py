"""Opening a case for a scene: only what it needs, or everything."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.build import build_phantom
from heartcase.simulator.load import Case, load_case


@dataclass(frozen=True)
class Inputs:
    """A finished case, and the parts to load."""

    case: Path
    needs: tuple[str, ...]


def prepare(params: dict[str, Any]) -> Inputs:
    needs = tuple(params.pop("needs"))
    directory = Path(tempfile.gettempdir()) / "heartcase-benchmark-case"
    return Inputs(build_phantom(params, directory), needs)


def heartcase(inputs: Inputs) -> Case:
    return load_case(inputs.case, needs=inputs.needs)


METHODS = {"heartcase": heartcase}


def errors(inputs: Inputs, output: Case) -> dict[str, float]:
    """What was loaded."""
    return {"nodes [1]": float(output.model.node_count), "parts [1]": float(len(inputs.needs))}
