"""A blade that is drawn through the adult's moving heart, sample by sample: what a frame waits for each.

A hand pulls, and in each frame of 1/60 s the blade goes on by a cell, askew to the grid, through a wall: a run is one
such sample, and a stroke has 16 of them, each of which the lattice and the fine surface of all before follow.

``ahead`` begins the cut, takes frames until it is there, and makes it: the time is that from the sample to the split
surface on show, the frames between with it. What a frame waits for, in it and in the one that makes the cut, stands
beside it, and so do the frames. ``live`` is a whole stroke with a sample in every frame, as a hand gives them: what the
blade does while a cut is worked out becomes the next, and the time is that until all of it is on show. ``cut`` does all
in one frame, without steps. ``plain`` parts the lattice by virtual nodes in plain NumPy over whole arrays and makes the
engine anew; ``springs_removed`` takes the springs away that the blade crosses; neither splits a surface. (Pieces of
cells are found by our kernels in ``plain``, too.)

``HEARTCASE_CASE`` may name a case that was built elsewhere.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter, thread_time
from typing import Any

import numpy as np

from benchmarks.cut_heart import crossed_springs
from benchmarks.frame import built_case
from benchmarks.plain_parting import plain_parted
from heartcase.schemas.arrays import Float64
from heartcase.schemas.recording.commands import CloseGrab, Cut, LeadGrab
from heartcase.simulator.cutting.blade_sheet import Sheet
from heartcase.simulator.cutting.cuts import Cuts
from heartcase.simulator.cutting.parted_lattice import links_together
from heartcase.simulator.cutting.pieces import find_pieces
from heartcase.simulator.engine.backends import make_engine
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.load import Case, load_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.perform_tools import as_poses
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.snapshot import Snapshot

FRAME_S = 1 / 60
SAMPLE_COUNT, HALF_BLADE = 16, 4.0
"""Samples of a stroke, one cell each, and half the blade's length [cells]."""
_NORMAL, _ALONG = np.array([0.25, 0.95, 0.2]), np.array([1.0, 0.0, 0.3])


@dataclass
class Inputs:
    """A heart in motion, where the stroke is, and what was measured."""

    case: Case
    session: OperatingSession
    start: Snapshot
    poses: Float64
    """Edge of the blade at each pose, in the frame of the nodes [cells], shape (SAMPLE_COUNT + 1, 2, 3)."""
    cuts: Cuts
    """Nothing cut: what ``plain`` begins with."""
    sample: int = 0
    taken: dict[str, list[float]] = field(default_factory=dict)
    """Times by name, ms."""
    stroke: list[Sheet] = field(default_factory=list)
    """Of ``plain``: what was cut by now."""
    cut_count: int = 0
    """Of ``live``: frames in which a cut was made."""

    def note(self, name: str, seconds: float) -> None:
        """Keep a time."""
        self.taken.setdefault(name, []).append(1e3 * seconds)

    def next_sample(self) -> int:
        """Number of the next sample; after the last of a stroke all is as it was."""
        if self.sample == SAMPLE_COUNT:
            self.sample = 0
            self.stroke.clear()
            self.session.simulation.restore(self.start)
            self.session = OperatingSession(self.session.simulation, snapshot_every_s=np.inf)
        self.sample += 1
        return self.sample - 1

    def poses_mm(self, sample: int) -> Float64:
        """Edge of the blade before and after a sample, LPS mm, shape (2, 2, 3)."""
        places = self.case.model.geometry.index_to_world(self.poses[sample : sample + 2].reshape(-1, 3) - 0.5)
        poses: Float64 = np.asarray(places).reshape(2, 2, 3)
        return poses


def prepare(params: dict[str, Any]) -> Inputs:
    path = Path(os.environ["HEARTCASE_CASE"]) if "HEARTCASE_CASE" in os.environ else built_case(params)
    case = load_case(path, needs=("surface",))
    model = case.model.with_law(ForceLaw(params.get("law", "springs")))
    simulation = Simulation(model, surface=case.surface, tissue=case.tissue)
    simulation.prepare()
    simulation.prepare_cuts()
    session = OperatingSession(simulation, snapshot_every_s=np.inf)
    normal = _NORMAL / np.linalg.norm(_NORMAL)
    along = np.cross(np.cross(normal, _ALONG), normal)
    along /= np.linalg.norm(along)
    across = HALF_BLADE * np.cross(normal, along)
    middle = model.node_index[model.node_count // 2] + np.array([0.31, 0.27, 0.43])
    ways = np.arange(SAMPLE_COUNT + 1) - SAMPLE_COUNT / 2
    poses = middle + ways[:, None, None] * along + np.stack([-across, across])
    held = tuple((model.rest_positions_mm()[model.node_count // 2] + (8.0, 0.0, 0.0)).tolist())
    session.do(CloseGrab(name="hand", center_mm=held, radius_mm=6.0))
    session.do(LeadGrab(name="hand", offset_mm=(2.0, 1.0, 0.0)))
    session.advance(round(0.05 / simulation.step_s), surface=True)
    return Inputs(case, session, simulation.snapshot(), poses, simulation.nothing_cut())


def ahead(inputs: Inputs) -> Simulation:
    poses = inputs.poses_mm(inputs.next_sample())
    session, simulation = inputs.session, inputs.session.simulation
    steps = round(FRAME_S / simulation.step_s)
    command = Cut(poses_mm=as_poses(poses))

    def show(name: str) -> None:
        start = perf_counter()
        session.take([], steps, surface=True)
        inputs.note(name, perf_counter() - start)

    show("frame before a sample")
    start, own = perf_counter(), thread_time()
    session.begin_cut(command)
    inputs.note("the sample's frame waits", perf_counter() - start)
    begun = thread_time() - own
    while not simulation.is_cut_ready:
        show("frame meanwhile")
    own, again = thread_time(), perf_counter()
    session.make_cuts()
    simulation.surface_now()
    inputs.note("the frame that makes the cut waits", perf_counter() - again)
    inputs.note("work of the frames' thread", begun + thread_time() - own)
    inputs.note("from the sample to the split surface", perf_counter() - start)
    return simulation


def live(inputs: Inputs) -> Simulation:
    inputs.sample = SAMPLE_COUNT
    inputs.next_sample()
    session, simulation = inputs.session, inputs.session.simulation
    steps = round(FRAME_S / simulation.step_s)
    for _ in range(SAMPLE_COUNT):
        start = perf_counter()
        session.take([], steps, surface=True)
        inputs.note("frame before a stroke", perf_counter() - start)
    start, made = perf_counter(), simulation.cuts
    inputs.cut_count = 0
    for sample in range(10 * SAMPLE_COUNT):
        own = perf_counter()
        commands = [Cut(poses_mm=as_poses(inputs.poses_mm(sample)))] if sample < SAMPLE_COUNT else []
        frame = session.take(commands, steps, surface=True, cuts_soon=True)
        inputs.note("frame of a stroke", perf_counter() - own)
        inputs.cut_count += simulation.cuts is not made
        made = simulation.cuts
        if sample == SAMPLE_COUNT - 1:
            last = perf_counter()
        if sample >= SAMPLE_COUNT and not frame.coming_cuts:
            break
    inputs.note("from the last sample to the split surface", perf_counter() - last)
    inputs.note("from the first sample to the split surface of all", perf_counter() - start)
    return simulation


def cut(inputs: Inputs) -> Simulation:
    poses = inputs.poses_mm(inputs.next_sample())
    simulation = inputs.session.simulation
    start = perf_counter()
    simulation.cut(poses)
    simulation.surface_now()
    inputs.note("from the sample to the split surface", perf_counter() - start)
    return simulation


def plain(inputs: Inputs) -> Simulation:
    sample = inputs.next_sample()
    start = perf_counter()
    inputs.stroke.append(Sheet.swept(inputs.poses[sample : sample + 2]))
    uncut, tissue = inputs.cuts.uncut, inputs.cuts.tissue
    links = links_together([sheet.links for sheet in inputs.stroke])
    beyond = links_together([sheet.links_beyond for sheet in inputs.stroke])
    parted = plain_parted(uncut, find_pieces(uncut, tissue, links, beyond))
    engine = make_engine(parted.model, "cpu")
    engine.load(parted.carried(inputs.start.state))
    inputs.note("from the sample to the cut lattice", perf_counter() - start)
    return inputs.session.simulation


def springs_removed(inputs: Inputs) -> Simulation:
    sample = inputs.next_sample()
    simulation = inputs.session.simulation
    start = perf_counter()
    poses = inputs.poses[sample : sample + 2]
    middle = poses.mean(axis=(0, 1))
    half_sides = (poses[1].mean(axis=0) - middle, poses[:, 1].mean(axis=0) - middle)
    simulation.remove_springs(crossed_springs(simulation.model, np.stack([middle, *half_sides])))
    inputs.note("from the sample to the cut lattice", perf_counter() - start)
    return simulation


REPEATS = {"live": 5}
METHODS = {"live": live, "ahead": ahead, "cut": cut, "plain": plain, "springs_removed": springs_removed}


def errors(inputs: Inputs, output: Simulation) -> dict[str, float]:
    """Median, 99% and longest of each time, sizes, and what was lost."""
    model, surface = output.model, output.surface
    assert surface is not None
    mass = inputs.case.model.node_mass.sum(dtype=float)
    figures = {
        "nodes [1]": float(model.node_count),
        "springs [1]": float(model.spring_count),
        "triangles [1]": float(len(surface.triangles)),
        "mass lost [1]": 1.0 - float(model.node_mass.sum(dtype=float)) / mass,
        "processes that want a core [1]": os.getloadavg()[0],
    }
    if inputs.cut_count:
        figures["cuts of the stroke [1]"] = float(inputs.cut_count)
    if output.split is not None:
        figures["lip places with one side alone [1]"] = float(lone_places(output))
        figures["cut faces [1]"] = float(output.split.triangle_is_cut_face.sum())
    for name, times in inputs.taken.items():
        for part, share in (("median", 50), ("99%", 99), ("longest", 100)):
            figures[f"{name}, {part} [ms]"] = float(np.percentile(times, share))
    return figures


def lone_places(simulation: Simulation) -> int:
    """Places of lips, to 1e-6 cells, at which there is one side alone: where a lip ends, and nowhere else."""
    split, surface = simulation.split, simulation.surface
    assert split is not None
    assert surface is not None
    lip = np.flatnonzero((split.on_triangle >= 0) & (split.weld == np.arange(len(split.weld))))
    places = surface.rest_mm[lip].astype(np.float64) / simulation.model.cell_mm
    near = np.linalg.norm(places[:, None] - places[None], axis=2) < 1e-6
    return int((near.sum(axis=1) == 1).sum())
