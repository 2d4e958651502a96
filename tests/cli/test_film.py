"""From where a film looks at cuts."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.cli.shared.film import Filmer

pytest.importorskip("PIL.Image")


def heart_with_an_artery() -> np.ndarray:
    """Points all over a ball of 30 mm, and over a tube of 10 mm that goes up from it."""
    turn, height = np.meshgrid(np.linspace(0, 2 * np.pi, 60, endpoint=False), np.linspace(-1, 1, 60))
    ball = np.stack([np.sqrt(1 - height**2) * np.cos(turn), np.sqrt(1 - height**2) * np.sin(turn), height], axis=-1)
    tube = np.stack([10 * np.cos(turn), 10 * np.sin(turn), 55 + 25 * height], axis=-1)
    return np.concatenate([30 * ball.reshape(-1, 3), tube.reshape(-1, 3)]).astype(np.float32)


@pytest.mark.parametrize(
    ("along", "out"),
    [
        # along the front of the artery, which leads away from the heart
        (np.array([[0, -10, z] for z in (45, 55, 65)]), np.array([0, -1, 0])),
        # on the ball, far to the side of its middle
        (np.array([[24, -18, z] for z in (-8, 0, 8)]), np.array([0.8, -0.6, 0])),
    ],
    ids=["artery", "ventricle"],
)
def test_a_cut_is_looked_at_from_outside_in_whatever_order_its_points_are_told(along, out):
    rest_mm = heart_with_an_artery()
    edges = np.stack([along + 2.0 * out, along - 5.0 * out], axis=1)
    seen = set()
    for blade in (edges, edges[::-1], edges[:, ::-1], *(one.swapaxes(0, 1) for one in (edges, edges[:, ::-1]))):
        camera = Filmer(rest_mm, blades_mm=[blade]).camera
        assert camera.towards == pytest.approx(out, abs=1e-6)
        seen.add((*np.round(camera.centre_mm, 6), round(camera.mm_per_pixel, 6)))
    assert len(seen) == 1
