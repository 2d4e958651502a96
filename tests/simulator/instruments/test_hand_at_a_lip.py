"""A hand that closes beside a short incision: its ball reaches around the end, and it holds one lip alone."""

from __future__ import annotations

import numpy as np

from heartcase.simulator.instruments.grab import nodes_in_reach
from heartcase.simulator.instruments.held_tissue import cells_at_nodes, tissue_at_rest
from heartcase.simulator.simulation import Simulation
from tests.simulator.lattices import block

HALF = 3.2
"""The incision goes along the middle of a plate, so far to either side of its middle [cells]."""


def cut_plate():
    """A plate of 14 x 12 x 2 cells of 1 mm, cut through along x in its middle, between cells."""
    model = block(14, 12, 2, cell_mm=1.0)
    simulation = Simulation(model, sleep_mm=0.0)
    middle = model.rest_positions_mm().mean(axis=0)
    poses = [
        [(middle + np.array([x, 0.3, z])).tolist() for z in (3.0, -3.0)] for x in np.linspace(-HALF, HALF, 5)
    ]  # fmt: skip
    simulation.cut(poses)
    return simulation, middle


def across(simulation, middle, nodes):
    """Tissue that belongs to some nodes, lies beside the incision and on its other side: y below 0."""
    cells = np.unique(cells_at_nodes(simulation.model, nodes)[0])
    model = simulation.model
    place = model.geometry.index_to_world(tissue_at_rest(model)[cells] - 0.5) - middle
    return (np.abs(place[:, 0]) < HALF - 0.2) & (place[:, 1] < 0.3)


def test_a_hand_holds_one_lip_around_the_end_of_an_incision():
    simulation, middle = cut_plate()
    center = (middle + np.array([HALF - 1.2, 1.4, 0.0])).tolist()
    reached = nodes_in_reach(simulation.model, simulation.state.displacement, center, 2.2)
    assert across(simulation, middle, reached).any()
    hand = simulation.grab(center, 2.2)
    assert not across(simulation, middle, hand.nodes).any()
    # Whatever has all of its tissue on the lip's own side is held.
    cell, place = cells_at_nodes(simulation.model, reached)
    tissue = simulation.model.geometry.index_to_world(tissue_at_rest(simulation.model)[cell] - 0.5) - middle
    lowest = np.full(len(reached), np.inf)
    np.minimum.at(lowest, place, tissue[:, 1])
    assert set(reached[lowest > 0.3]) <= set(hand.nodes)
    assert (lowest > 0.3).sum() >= 10
    assert set(hand.nodes) <= set(reached)
    assert len(hand.arms) == len(hand.closed_at) == len(hand.nodes)


def test_far_from_incisions_a_hand_holds_all_that_it_reaches():
    simulation, middle = cut_plate()
    center = (middle + np.array([0.0, 4.5, 0.0])).tolist()
    reached = nodes_in_reach(simulation.model, simulation.state.displacement, center, 2.2)
    assert np.array_equal(simulation.grab(center, 2.2).nodes, reached)
