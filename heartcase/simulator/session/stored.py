"""Moments of a session as bytes, and back: state and instruments to the last digit (safetensors).

The lattice of a moment is not stored: it follows from the lattice at the start and the commands before.
"""

from __future__ import annotations

import json
from hashlib import sha256
from typing import Any

import numpy as np
import numpy.typing as npt
from safetensors import SafetensorError
from safetensors.numpy import load, save

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import RecordingError, SimulationError
from heartcase.schemas.recording.reader import Recording
from heartcase.simulator.cutting.cuts import Cuts
from heartcase.simulator.instruments.grab import Grab, Pose
from heartcase.simulator.instruments.probe import Probe
from heartcase.simulator.instruments.wrench import Instrument
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.state import PreciseState, State
from heartcase.simulator.session.operating_session import Deviation
from heartcase.simulator.session.perform import changed_lattice
from heartcase.simulator.session.stored_stitches import (
    patch_arrays,
    patches_from,
    stitch_arrays,
    stitch_names,
    stitches_from,
)
from heartcase.simulator.session.stored_tools import holding_from, kind_of, scissors_from, tool_arrays
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.snapshot import KeptInstrument, Snapshot

__all__ = ["RecordedStates", "lattice_sha256", "snapshot_bytes", "snapshot_from"]

Arrays = dict[str, npt.NDArray[Any]]

_PRECISE = ("precise_displacement", "precise_velocity")


def lattice_sha256(model: LatticeModel) -> str:
    """Hash of a lattice before anything is cut or joined, but for its law: the case of a recording must have it."""
    digest = sha256(json.dumps(model.geometry.model_dump(mode="json"), sort_keys=True).encode())
    for array in (
        model.cells,
        model.cell_coverage,
        model.cell_stiffness,
        model.cell_density,
        model.cell_moments,
        model.node_is_fixed,
    ):
        digest.update(repr(array.shape).encode() + np.ascontiguousarray(array).tobytes())
    units = model.units
    digest.update(np.array([units.length_m, units.mass_kg, units.time_s]).tobytes())
    return digest.hexdigest()


def snapshot_bytes(snapshot: Snapshot) -> bytes:
    """State, instruments, stitches and patches of a moment as a safetensors file."""
    state = snapshot.state
    arrays: Arrays = {"displacement": state.displacement, "velocity": state.velocity}
    if isinstance(state, PreciseState):
        arrays |= {name: getattr(state, name) for name in _PRECISE}
    instruments = []
    for number, kept in enumerate(snapshot.instruments):
        one = kept.then
        instruments.append({"kind": kind_of(one), "name": one.name})
        described = tool_arrays(one)
        if isinstance(one, Grab):
            described |= _grab_arrays(one)
        elif isinstance(one, Probe):
            described |= _probe_arrays(one)
        arrays |= {f"instrument_{number}_{name}": array for name, array in described.items()}
    stitches = [kept.then for kept in snapshot.stitches]
    told = {"step_count": str(state.step_count), "instruments": json.dumps(instruments)}
    if stitches:
        arrays |= stitch_arrays(stitches)
        told["stitches"] = json.dumps(stitch_names(stitches))
    patches = [kept.then for kept in snapshot.patches]
    if patches:
        arrays |= patch_arrays(patches)
        told["patches"] = json.dumps([patch.name for patch in patches])
    content: bytes = save({name: np.ascontiguousarray(array) for name, array in arrays.items()}, told)
    return content


def snapshot_from(content: bytes, model: LatticeModel, cuts: Cuts | None = None) -> Snapshot:
    """The moment that a file holds, of the lattice of that moment, of which some was cut.

    Raises
    ------
    RecordingError
        The file does not hold one, or one of another lattice.
    """
    try:
        arrays, told = load(content), _metadata(content)
        state = _state(arrays, int(told["step_count"]), model.node_count)
        instruments = tuple(
            _instrument(arrays, number, said, model.node_count)
            for number, said in enumerate(json.loads(told["instruments"]))
        )
        names = json.loads(told.get("stitches", "[]"))
        stitches = stitches_from(arrays, names, model, cuts) if names else []
        patches = patches_from(arrays, json.loads(told.get("patches", "[]")), model, cuts)
    except (SafetensorError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise RecordingError("a stored state does not fit the lattice or is damaged", place="state") from None
    kept = tuple(KeptInstrument.of(instrument) for instrument in instruments)
    threads = tuple(KeptInstrument.of(stitch) for stitch in stitches)
    return Snapshot(model, state, kept, cuts, threads, tuple(KeptInstrument.of(patch) for patch in patches))


class RecordedStates:
    """The states of a recording, for the session that repeats it."""

    def __init__(self, recording: Recording, model: LatticeModel, nothing_cut: Cuts, *, step_s: float) -> None:
        self._recording = recording
        self._step_s = step_s
        self._lattices = [(0, model, nothing_cut)]
        self._looked_at = 0

    def last_before(self, position: int) -> int | None:
        """The last position, up to this one, at which one was stored."""
        return max((stored for stored in self._recording.states if stored <= position), default=None)

    def snapshot(self, position: int) -> Snapshot:
        """The moment that was stored there.

        Raises
        ------
        RecordingError
            Its file is damaged, or does not fit.
        """
        model, cuts = self._lattice_at(position)
        return snapshot_from(self._recording.state_bytes(position), model, cuts if cuts.sheets else None)

    def deviation(self, position: int, simulation: Simulation) -> Deviation | None:
        """How the simulation, being there, differs from what was stored; None where it does not, or nothing was.

        Raises
        ------
        RecordingError
            The file of the state is damaged, or of another lattice.
        """
        if position not in self._recording.states:
            return None
        then = snapshot_from(self._recording.state_bytes(position), simulation.model).state
        now = simulation.state
        same = [np.array_equal(getattr(then, name), getattr(now, name)) for name in ("displacement", "velocity")]
        if isinstance(now, PreciseState) and isinstance(then, PreciseState):
            same += [np.array_equal(getattr(then, name), getattr(now, name)) for name in _PRECISE]
        if all(same):
            return None
        apart = np.linalg.norm(now.displacement.astype(float) - then.displacement, axis=1).max()
        return Deviation(self._recording.states[position].step, float(apart) * simulation.model.cell_mm)

    def _lattice_at(self, position: int) -> tuple[LatticeModel, Cuts]:
        """The lattice where so many entries are done, and what was cut of it."""
        for number in range(self._looked_at, position):
            _, model, cuts = self._lattices[-1]
            command = self._recording.entries[number].command
            try:
                changed, cuts = changed_lattice(model, cuts, command, step_s=self._step_s)
            except SimulationError as error:
                message = f"what entry {number + 1} joins or cuts cannot be: {error.problems[0].message}"
                raise RecordingError(message, place="log") from None
            if changed is not model:
                self._lattices.append((number + 1, changed, cuts))
        self._looked_at = max(self._looked_at, position)
        return next((model, cuts) for first, model, cuts in reversed(self._lattices) if first <= position)


def _grab_arrays(grab: Grab) -> Arrays:
    poses = [np.vstack([pose.offset, pose.turn]) for pose in (grab.pose, grab.target)]
    return {
        "nodes": grab.nodes.astype(np.int64),
        "closed_at": grab.closed_at,
        "arms": grab.arms,
        "poses": np.stack(poses).astype(float),
    }


def _probe_arrays(probe: Probe) -> Arrays:
    rows = [probe.semi_axes, probe.turn, probe.centre, probe.target, probe.half_axis, probe.wrench.reshape(2, 3)]
    return {"shape": np.vstack(rows).astype(float)}


def _metadata(content: bytes) -> dict[str, str]:
    """What a safetensors file says beside its arrays; its header was parsed before."""
    length = int.from_bytes(content[:8], "little")
    said: dict[str, str] = json.loads(content[8 : 8 + length])["__metadata__"]
    return said


def _taken(arrays: Arrays, name: str, dtype: type, *shape: int) -> npt.NDArray[Any]:
    array = arrays[name]
    if array.dtype != dtype or array.shape != shape:
        raise ValueError(name)
    return array


def _state(arrays: Arrays, step_count: int, node_count: int) -> State:
    displacement, velocity = (_taken(arrays, name, np.float32, node_count, 3) for name in ("displacement", "velocity"))
    if step_count < 0:
        raise ValueError("step_count")
    if _PRECISE[0] not in arrays:
        return State(displacement, velocity, step_count)
    precise, speed = (_taken(arrays, name, np.float64, node_count, 3) for name in _PRECISE)
    return PreciseState(displacement, velocity, step_count, precise_displacement=precise, precise_velocity=speed)


def _instrument(arrays: Arrays, number: int, said: dict[str, str], node_count: int) -> Instrument:
    def of(name: str, dtype: type, *shape: int) -> npt.NDArray[Any]:
        return _taken(arrays, f"instrument_{number}_{name}", dtype, *shape)

    if said["kind"] == "scissors":
        return scissors_from(of, str(said["name"]))
    if said["kind"] == "probe":
        rows: Float64 = of("shape", np.float64, 9, 3)
        probe = Probe(rows[0], rows[1:4], rows[4], rows[5], name=str(said["name"]), half_axis=rows[6])
        probe.wrench = rows[7:].ravel()
        return probe
    count = len(arrays[f"instrument_{number}_nodes"])
    nodes = of("nodes", np.int64, count).astype(np.intp)
    if not count or nodes.min() < 0 or nodes.max() >= node_count:
        raise ValueError("nodes")
    poses = of("poses", np.float64, 2, 4, 3)
    pose, target = (Pose(rows[0], rows[1:]) for rows in poses)
    closed_at, arms = of("closed_at", np.float32, count, 3), of("arms", np.float64, count, 3)
    held = {"nodes": nodes, "closed_at": closed_at, "arms": arms, "name": str(said["name"])}
    return holding_from(said["kind"], of, count, **held, pose=pose, target=target)
