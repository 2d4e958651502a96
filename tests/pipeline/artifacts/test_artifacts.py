import dataclasses

import numpy as np
import pytest

from heartcase.pipeline.artifacts.serialise import artifact_from_bytes, artifact_to_bytes, load_artifact
from heartcase.pipeline.data import Scan, SimulationGrid, Structures
from heartcase.pipeline.warnings import CaseWarning
from heartcase.schemas.errors import StageError
from heartcase.schemas.geometry import Geometry
from tests.factories import TABLE, block_grid, block_surface


def equal(a, b):
    for item in dataclasses.fields(a):
        left, right = getattr(a, item.name), getattr(b, item.name)
        if isinstance(left, np.ndarray):
            np.testing.assert_array_equal(left, right)
            assert left.dtype == right.dtype
        elif isinstance(left, dict) and left and isinstance(next(iter(left.values())), np.ndarray):
            assert list(left) == list(right)
            for key in left:
                np.testing.assert_array_equal(left[key], right[key])
        else:
            assert left == right


def examples():
    grid = dataclasses.replace(
        block_grid(), quality={"betti": [1, 0, 0], "x": 0.5}, warnings=(CaseWarning("a"), CaseWarning("b"))
    )
    surface, grid_map, picking = block_surface(grid)
    geometry = Geometry.of(shape=(2, 3, 4), spacing_mm=(0.1, 0.2, 0.3))
    structures = Structures(
        distance_mm={0: np.ones((2, 3, 4), np.float32), 9: -np.ones((2, 3, 4), np.float32)},
        geometry=geometry,
        table=TABLE,
        band_mm=4.5,
        fixed_planes=(((1.0, 2.0, 3.0), (0.0, 0.0, 1.0), 5.0),),
    )
    scan = Scan(np.zeros((2, 3, 4), np.float32), geometry, "MR", {"field_strength_t": 1.5})
    return [scan, structures, grid, surface, grid_map, picking]


@pytest.mark.parametrize("artifact", examples(), ids=lambda a: type(a).__name__)
def test_every_output_round_trips_and_its_bytes_repeat(artifact):
    content = artifact_to_bytes(artifact)
    assert artifact_to_bytes(artifact) == content
    equal(artifact_from_bytes(content, type(artifact)), artifact)


def test_the_wrong_kind_is_named():
    with pytest.raises(StageError, match="holds a SimulationGrid, but a Scan is needed"):
        artifact_from_bytes(artifact_to_bytes(block_grid()), Scan)


def test_damaged_bytes_are_refused():
    content = artifact_to_bytes(block_grid())
    for damaged in (b"", b"x" * 100, content[:50], content[:-1], content + b"x"):
        with pytest.raises(StageError):
            artifact_from_bytes(damaged, SimulationGrid)


def test_a_missing_file_is_one_line(tmp_path):
    with pytest.raises(StageError, match="cannot be read"):
        load_artifact(tmp_path / "none.safetensors", Scan)
