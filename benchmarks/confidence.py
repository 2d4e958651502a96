"""Whether the report's confidence, and the places that are suggested, point to what is wrong.

A voxel of the heart is *wrong* where its label is not the phantom's. The area under the curve (AUC) is the share of all
pairs of a wrong and a right voxel in which the wrong one is less confident: 50% for chance.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import rankdata

from benchmarks.accuracy import Inputs, prepare
from heartcase.pipeline.markers.confidence import Sureness, sureness_of
from heartcase.pipeline.watershed.certainty import voxel_certainty
from heartcase.pipeline.watershed.forest import solve_forest
from heartcase.pipeline.watershed.tree import BasinTree
from heartcase.pipeline.watershed.tree_cache import scan_tree
from heartcase.schemas.arrays import Bool, Float32
from heartcase.schemas.recipe.settings import SegmentSettings

__all__ = ["METHODS", "errors", "heartcase", "prepare"]


def _tree(inputs: Inputs) -> BasinTree:
    return scan_tree(inputs.filtered, SegmentSettings())


def heartcase(inputs: Inputs) -> Sureness:
    """What a build adds for the report; the tree is counted too, though a build has it already."""
    return sureness_of(_tree(inputs), inputs.markers, count=10)


METHODS = {"heartcase": heartcase}


def errors(inputs: Inputs, output: Sureness) -> dict[str, float]:
    """Shares of wrong voxels by confidence, AUC, and the share of suggested places that are wrong."""
    forest = solve_forest(_tree(inputs), inputs.markers.labels)
    heart = (inputs.true_labels > 0) & ~inputs.behind_ends
    wrong = forest.labels[heart] != inputs.true_labels[heart]
    confidence = output.confidence[heart]
    places = np.rint(
        inputs.filtered.geometry.world_to_index(np.array([place.position_mm for place in output.strokes.places]))
    ).astype(int)
    k, j, i = places[:, 2], places[:, 1], places[:, 0]
    at_places = forest.labels[k, j, i] != inputs.true_labels[k, j, i]

    def share(where: Bool) -> float:
        return 100.0 * float(wrong[where].mean()) if where.any() else float("nan")

    return {
        "wrong voxels [%]": 100.0 * float(wrong.mean()),
        "wrong where confidence is below 0.75 [%]": share(confidence < 0.75),
        "wrong where confidence is 0.9 or more [%]": share(confidence >= 0.9),
        "AUC of the confidence [%]": 100.0 * _auc(confidence, wrong),
        "AUC of the certainty [%]": 100.0 * _auc(voxel_certainty(forest)[heart], wrong),
        "suggested places that are wrong [%]": 100.0 * float(at_places.mean()),
    }


def _auc(sure: Float32, wrong: Bool) -> float:
    """Mann and Whitney's statistic of the wrong voxels against the right ones, ties by half."""
    rank = rankdata(sure)
    wrong_count, right_count = int(wrong.sum()), int((~wrong).sum())
    below = float(rank[~wrong].sum()) - right_count * (right_count + 1) / 2.0
    return below / (wrong_count * right_count)
