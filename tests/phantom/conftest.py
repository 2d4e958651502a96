import numpy as np
import pytest

from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.schemas.arrays import Float64
from heartcase.schemas.geometry import Geometry


@pytest.fixture(scope="session")
def adult() -> HeartPhantom:
    return HeartPhantom.adult()


@pytest.fixture(scope="session")
def child() -> HeartPhantom:
    return HeartPhantom.child()


def lattice_points(geometry: Geometry) -> Float64:
    """World position of every voxel centre, shape (*geometry.shape, 3)."""
    return geometry.index_to_world(np.moveaxis(np.indices(geometry.shape), 0, -1)[..., ::-1])


@pytest.fixture(scope="session")
def adult_voxels(adult):
    """Geometry, points and true labels of the adult at 1.5 mm."""
    geometry = adult.scan_geometry(1.5, margin_mm=4.0)
    points = lattice_points(geometry)
    return geometry, points, adult.truth.label(points)
