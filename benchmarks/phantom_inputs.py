"""Synthetic scans for the cases, kept between runs because making them takes longer than what is measured."""

from __future__ import annotations

import hashlib
import math
import tempfile
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

import heartcase.phantom
from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.phantom.drawing.strokes import marker_strokes
from heartcase.phantom.scan.acquisition import CT_UNITS, MRI_UNITS, CtArtefacts, acquire_ct, acquire_mri, noise_free
from heartcase.pipeline.artifacts.cache import Cache, stage_key
from heartcase.pipeline.data import Markers, Scan, Segmentation
from heartcase.pipeline.markers.load_markers import load_markers
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.heart_form import HeartForm

STREAK_HU = 150.0
"""By how much streaks from undiluted contrast medium darken the worst place."""


@dataclass(frozen=True)
class PhantomInputs:
    """A synthetic scan and what is true of it."""

    phantom: HeartPhantom
    scan: Scan
    clean: Scan
    truth: Segmentation
    markers: Markers


def phantom_inputs(params: dict[str, Any]) -> PhantomInputs:
    """Scan, true labels and markers for ``size``, ``modality``, ``spacing_mm``, ``noise`` and ``seed``.

    ``body_surface_m2`` takes the heart of that size instead; ``texture`` gives a CT noise that neighbours share,
    ``contrast_hu`` contrast medium that is still undiluted in the superior vena cava and 150 HU of streaks from it.
    """
    params = {"size": "adult", "modality": "mri", "spacing_mm": 1.75, "seed": 1} | params
    phantom = phantom_of(params["size"], params.get("body_surface_m2"))
    geometry = phantom.scan_geometry(params["spacing_mm"], oblique=params.get("oblique", False))
    key = code_key(params)
    kept = Cache(Path(tempfile.gettempdir()) / "heartcase-benchmark-inputs")
    scan = kept.load("scan", key, Scan)
    clean = kept.load("clean", key, Scan)
    truth = kept.load("truth", key, Segmentation)
    if scan is None or clean is None or truth is None:
        acquire = acquire_mri if params["modality"] == "mri" else acquire_ct
        options: dict[str, Any] = {"contrast_to_noise": params["noise"]} if "noise" in params else {}
        caval_hu = params.get("contrast_hu")
        if params["modality"] == "ct":
            options["artefacts"] = CtArtefacts(
                texture=params.get("texture", False),
                # neighbours in a slice then share a third of their noise, as those of two slices do
                texture_peak_per_mm=0.21 / geometry.spacing_mm[0],
                slice_correlation=0.35,
                streak=0.0 if caval_hu is None else STREAK_HU,
                caval_hu=caval_hu,
            )
        signal = _signal(phantom, params["modality"], geometry, caval_hu)
        made = acquire(phantom, geometry, seed=params["seed"], signal=signal, **options)
        scan = Scan(made.values, geometry, made.modality)
        made = acquire(
            phantom, geometry, seed=params["seed"], signal=signal, **options | {"contrast_to_noise": math.inf}
        )
        clean = Scan(made.values, geometry, made.modality)
        indices = np.indices(geometry.shape).reshape(3, -1)[::-1].T
        labels = phantom.truth.label(geometry.index_to_world(indices))
        table = phantom.truth.table
        truth = Segmentation(labels.reshape(geometry.shape), geometry, table)
        kept.store("scan", key, scan, seconds=0.0)
        kept.store("clean", key, clean, seconds=0.0)
        kept.store("truth", key, truth, seconds=0.0)
    markers = load_markers((), marker_strokes(phantom), phantom.table, geometry, Path())
    return PhantomInputs(phantom, scan, clean, truth, markers)


@lru_cache(maxsize=1)
def _signal(phantom: HeartPhantom, modality: str, geometry: Geometry, caval_hu: float | None) -> Any:
    """The noise-free signal, the same at every noise; no more than one, as it is the largest array here."""
    units = MRI_UNITS if modality == "mri" else CT_UNITS
    return noise_free(phantom, geometry, units if caval_hu is None else (*units, caval_hu))


@cache
def phantom_of(size: str, body_surface_m2: float | None) -> HeartPhantom:
    """A heart of fixed size, or that of a body surface area."""
    if body_surface_m2 is None:
        return HeartPhantom.of_size(size)
    return HeartPhantom.of_form(HeartForm(body_surface_m2=body_surface_m2))


def code_key(settings: Any) -> str:
    """Key of what the phantom's present code makes from these settings, 64 hexadecimal digits."""
    # How markers are drawn changes nothing that is kept.
    folder = Path(heartcase.phantom.__file__).parent
    sources = sorted(
        path for path in folder.rglob("*.py") if path.name not in ("strokes.py", "recipe.py", "metrics.py")
    )
    code = hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()
    return stage_key(stage="phantom", version=1, settings=settings, inputs={"code": code})


def bare_truth(inputs: PhantomInputs) -> Any:
    """The true labels as a person would paint them: grown walls count as background."""
    labels = inputs.truth.labels.copy()
    for label in inputs.truth.table:
        if label.wall_of is not None:
            labels[labels == label.value] = 0
    return labels
