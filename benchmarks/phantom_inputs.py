"""Synthetic scans for the cases, kept between runs because making them takes longer than what is measured."""

from __future__ import annotations

import hashlib
import math
import tempfile
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

import heartcase.phantom
from heartcase.phantom.acquisition import CT_UNITS, MRI_UNITS, acquire_ct, acquire_mri, noise_free
from heartcase.phantom.heart import HeartPhantom
from heartcase.phantom.strokes import marker_strokes
from heartcase.pipeline.cache import Cache, stage_key
from heartcase.pipeline.data import Markers, Scan, Segmentation
from heartcase.pipeline.markers import load_markers
from heartcase.schemas.geometry import Geometry


@dataclass(frozen=True)
class PhantomInputs:
    """A synthetic scan and what is true of it."""

    phantom: HeartPhantom
    scan: Scan
    clean: Scan
    truth: Segmentation
    markers: Markers


def phantom_inputs(params: dict[str, Any]) -> PhantomInputs:
    """Scan, true labels and markers for ``size``, ``modality``, ``spacing_mm``, ``noise`` and ``seed``."""
    params = {"size": "adult", "modality": "mri", "spacing_mm": 1.75, "seed": 1} | params
    phantom = HeartPhantom.of_size(params["size"])
    geometry = phantom.scan_geometry(params["spacing_mm"], oblique=params.get("oblique", False))
    key = code_key(params)
    cache = Cache(Path(tempfile.gettempdir()) / "heartcase-benchmark-inputs")
    scan = cache.load("scan", key, Scan)
    clean = cache.load("clean", key, Scan)
    truth = cache.load("truth", key, Segmentation)
    if scan is None or clean is None or truth is None:
        acquire = acquire_mri if params["modality"] == "mri" else acquire_ct
        options = {"contrast_to_noise": params["noise"]} if "noise" in params else {}
        signal = _signal(params["size"], params["modality"], geometry)
        made = acquire(phantom, geometry, seed=params["seed"], signal=signal, **options)
        scan = Scan(made.values, geometry, made.modality)
        made = acquire(phantom, geometry, seed=params["seed"], signal=signal, contrast_to_noise=math.inf)
        clean = Scan(made.values, geometry, made.modality)
        indices = np.indices(geometry.shape).reshape(3, -1)[::-1].T
        labels = phantom.truth.label(geometry.index_to_world(indices))
        table = phantom.truth.table
        truth = Segmentation(labels.reshape(geometry.shape), geometry, table)
        cache.store("scan", key, scan, seconds=0.0)
        cache.store("clean", key, clean, seconds=0.0)
        cache.store("truth", key, truth, seconds=0.0)
    markers = load_markers((), marker_strokes(phantom), phantom.table, geometry, Path())
    return PhantomInputs(phantom, scan, clean, truth, markers)


@lru_cache(maxsize=1)
def _signal(size: str, modality: str, geometry: Geometry) -> Any:
    """The noise-free signal, the same at every noise; no more than one, as it is the largest array here."""
    return noise_free(HeartPhantom.of_size(size), geometry, MRI_UNITS if modality == "mri" else CT_UNITS)


def code_key(settings: Any) -> str:
    """Key of what the phantom's present code makes from these settings, 64 hexadecimal digits."""
    # How markers are drawn changes nothing that is kept.
    folder = Path(heartcase.phantom.__file__).parent
    sources = sorted(path for path in folder.glob("*.py") if path.name not in ("strokes.py", "recipe.py", "metrics.py"))
    code = hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()
    return stage_key(stage="phantom", version=1, settings=settings, inputs={"code": code})


def bare_truth(inputs: PhantomInputs) -> Any:
    """The true labels as a person would paint them: grown walls count as background."""
    labels = inputs.truth.labels.copy()
    for label in inputs.truth.table:
        if label.wall_of is not None:
            labels[labels == label.value] = 0
    return labels
