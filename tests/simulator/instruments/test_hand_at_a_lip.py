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
    away = np.linalg.norm(simulation.model.rest_positions_mm()[hand.nodes] - center, axis=1)
    assert away.max() <= 2.2
    assert len(hand.arms) == len(hand.closed_at) == len(hand.nodes)


def test_far_from_incisions_a_hand_holds_all_that_it_reaches():
    simulation, middle = cut_plate()
    center = (middle + np.array([0.0, 4.5, 0.0])).tolist()
    reached = nodes_in_reach(simulation.model, simulation.state.displacement, center, 2.2)
    assert np.array_equal(simulation.grab(center, 2.2).nodes, reached)


def test_a_hand_beside_an_incision_holds_the_lip_that_its_centre_lies_on():
    # A cell that was cut has copies of nodes beyond the cut. They lie where those of the other lip do, also nearest to
    # a hand's centre, and are tissue of their own lip all the same.
    simulation, middle = cut_plate()
    model = simulation.model
    for y in (-1.2, -0.7, -0.2, 0.8, 1.3, 1.8):
        for x in (-1.5, -0.5, 0.0, 0.5, 1.5):
            hand = simulation.grab((middle + np.array([x, y, 0.4])).tolist(), 1.8)
            cells = np.unique(cells_at_nodes(model, hand.nodes)[0])
            tissue = model.geometry.index_to_world(tissue_at_rest(model)[cells] - 0.5) - middle
            beside = np.abs(tissue[:, 0]) < HALF - 0.2
            assert ((tissue[beside, 1] > 0.3) == (y > 0.3)).all(), (x, y)
            simulation.release(hand)
