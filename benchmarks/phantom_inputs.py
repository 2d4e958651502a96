"""Synthetic scans for the cases, kept between runs because making them takes longer than what is measured."""

from __future__ import annotations

import hashlib
import math
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import heartcase.phantom
from heartcase.phantom.acquisition import acquire_ct, acquire_mri
from heartcase.phantom.heart import HeartPhantom
from heartcase.phantom.strokes import marker_strokes
from heartcase.pipeline.cache import Cache, stage_key
from heartcase.pipeline.data import Markers, Scan, Segmentation
from heartcase.pipeline.markers import load_markers


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
    sources = sorted(Path(heartcase.phantom.__file__).parent.glob("*.py"))
    code = hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()
    key = stage_key(stage="phantom", version=1, settings=params, inputs={"code": code})
    cache = Cache(Path(tempfile.gettempdir()) / "heartcase-benchmark-inputs")
    scan = cache.load("scan", key, Scan)
    clean = cache.load("clean", key, Scan)
    truth = cache.load("truth", key, Segmentation)
    if scan is None or clean is None or truth is None:
        acquire = acquire_mri if params["modality"] == "mri" else acquire_ct
        options = {"contrast_to_noise": params["noise"]} if "noise" in params else {}
        made = acquire(phantom, geometry, seed=params["seed"], **options)
        scan = Scan(made.values, geometry, made.modality)
        made = acquire(phantom, geometry, seed=params["seed"], contrast_to_noise=math.inf)
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


def bare_truth(inputs: PhantomInputs) -> Any:
    """The true labels as a person would paint them: grown walls count as background."""
    labels = inputs.truth.labels.copy()
    for label in inputs.truth.table:
        if label.wall_of is not None:
            labels[labels == label.value] = 0
    return labels
