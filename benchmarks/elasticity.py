"""The three force laws against finite elements: springs, springs with a volume term, hexahedral elements.

A scene is put together at some number of cells, brought to equilibrium, and what it measures is held against the truth
(:mod:`elasticity_truth`). Run it with ``OPENBLAS_NUM_THREADS=1``, the products are small.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from math import sqrt
from pathlib import Path
from typing import Any

from benchmarks.elasticity_scenes import (
    BAR_LENGTH,
    CANTILEVER_LENGTH,
    CANTILEVER_LOAD,
    TWIST,
    lattice_of,
    saint_venant_torque,
    scene,
    solve_lattice,
    timoshenko_deflection,
)
from benchmarks.elasticity_shells import (
    VENTRICLE_INNER,
    VENTRICLE_OUTER,
    solve_tube,
    solve_ventricle,
    tube,
    tube_truth,
    ventricle,
)
from benchmarks.elasticity_strips import Strip
from benchmarks.runner.cases import MethodSkipped
from benchmarks.statics import NoEquilibriumError
from heartcase.simulator.dynamics.integrate import Verlet
from heartcase.simulator.dynamics.step_size import SAFETY
from heartcase.simulator.engine.backends import make_engine
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.lattice.state import State

THICKNESS_MM = 10.0
"""Thickness of a bar, half the width of the punch: with it a number of cells is a size of cells."""


@dataclass(frozen=True)
class Inputs:
    """A scene and how finely it is cut."""

    scene: str
    cells: float
    """Cells across the bar, in half the punch's width, or through the wall or strip."""
    ratio: float
    """Poisson's ratio of the truth."""
    is_large: bool
    wall: float
    """Wall of the tube over its inner radius."""
    angle_deg: float
    """Of a strip from the cells' axes."""
    roll_deg: float
    """Of a strip about its length."""


@dataclass(frozen=True)
class Measured:
    """What a law made of it."""

    values: dict[str, float]
    model: LatticeModel | None = None
    """The lattice; None for a peer."""


def prepare(params: dict[str, Any]) -> Inputs:
    is_large = params.get("strain", "small") == "large"
    tilt = (params.get("angle_deg", 0), params.get("roll_deg", 0))
    return Inputs(params["scene"], params["cells"], params["ratio"], is_large, params.get("wall", 0.5), *tilt)


def springs(inputs: Inputs) -> Measured:
    """Springs alone: their ratio is 1/4 whatever is asked."""
    return _measured(inputs, ForceLaw("springs"))


def volume(inputs: Inputs) -> Measured:
    """Springs with a volume term."""
    law = ForceLaw("springs", inputs.ratio)
    if not law.has_volume_term:
        raise MethodSkipped("at a ratio of 1/4 it is springs alone")
    return _measured(inputs, law)


def element(inputs: Inputs) -> Measured:
    """Hexahedral elements."""
    return _measured(inputs, ForceLaw("element", inputs.ratio))


def unshared(inputs: Inputs) -> Measured:
    """Hexahedral elements that share no strain."""
    if inputs.scene not in ("tube", "strip", "ventricle"):
        raise MethodSkipped("in cells that are all full elements share none")
    return _measured(inputs, ForceLaw("element", inputs.ratio, shares_strain=False))


def trilinear(inputs: Inputs) -> Measured:
    """scikit-fem's trilinear hexahedra, of the boxes in small strain."""
    if inputs.is_large or inputs.scene in ("tube", "strip", "ventricle"):
        raise MethodSkipped("it is for boxes in small strain")
    try:
        from benchmarks.elasticity_peer import solve_trilinear
    except ImportError:
        raise MethodSkipped("it needs scikit-fem: pip install '.[dev]'") from None
    one = scene(inputs.scene, is_large=False)
    return Measured({one.quantity: solve_trilinear(one, int(inputs.cells), ForceLaw("element", inputs.ratio))})


METHODS: dict[str, Callable[[Inputs], Measured]] = {
    "springs": springs,
    "volume": volume,
    "element": element,
    "unshared": unshared,
    "trilinear": trilinear,
}


def errors(inputs: Inputs, output: Measured) -> dict[str, float]:
    """Error of each figure against each truth, the truth's own, and what the lattice costs to run."""
    found: dict[str, float] = {}
    for against, truths in _truths(inputs).items():
        for name, (value, uncertainty) in truths.items():
            ratio = output.values[name] / value
            found[f"error of the {name} against {against} [%]"] = 100.0 * abs(ratio - 1.0)
            found[f"{name} over that of {against} [1]"] = ratio
            if uncertainty:
                found[f"uncertainty of {against}'s {name} [%]"] = 100.0 * uncertainty
    return found if output.model is None else found | cost(output.model)


def cost(model: LatticeModel) -> dict[str, float]:
    """What a second of simulation takes."""
    steps = 1.0 / step_s(model)
    return {
        "steps per simulated second [1/s]": steps,
        "node steps per simulated second [1/s]": steps * model.node_count,
        "CPU time per simulated second [s/s]": seconds_per_simulated_second(model),
    }


def step_s(model: LatticeModel) -> float:
    """The default step by the law's own bound, s; one material."""
    return SAFETY * 2.0 / sqrt(model.law.stretched_bound) * model.units.time_s


def seconds_per_simulated_second(model: LatticeModel) -> float:
    """CPU seconds that the engine takes for a second of simulation."""
    engine = make_engine(model, "cpu")
    step = step_s(model)
    rule = Verlet(step / model.units.time_s, damping=10.0 * model.units.time_s)
    engine.load(State.at_rest(model.node_count))
    engine.advance(50, rule)
    count, taken = 100, 0.0
    while taken < 0.1:
        count *= 2
        start = time.process_time()
        engine.advance(count, rule)
        taken = time.process_time() - start
    return taken / count / step


def _measured(inputs: Inputs, law: ForceLaw) -> Measured:
    n = inputs.cells
    try:
        if inputs.scene == "tube":
            model = tube(inputs.wall, n, law)
            return Measured({"radial displacement": solve_tube(model, inputs.wall, n)}, model)
        if inputs.scene == "ventricle":
            model = ventricle(n, law)
            apex, change = solve_ventricle(model, n)
            return Measured({"apex displacement": apex, "volume change": change}, model)
        if inputs.scene == "strip":
            strip = Strip(n, inputs.angle_deg, inputs.roll_deg)
            model = strip.model(law, THICKNESS_MM / n)
            found = {"rotation": strip.rotation_over_beam(model), "stretch": strip.stretch_over_bar(model)}
            return Measured(found, model)
        one = scene(inputs.scene, inputs.is_large)
        model = lattice_of(one, int(n), law, THICKNESS_MM)
        return Measured({one.quantity: solve_lattice(one, model, int(n))}, model)
    except NoEquilibriumError as error:
        raise MethodSkipped(str(error)) from None


Truths = dict[str, dict[str, tuple[float, float]]]
"""What was the truth -> name of the figure -> value and uncertainty."""


def _truths(inputs: Inputs) -> Truths:
    """All truths of a case."""
    by_formula = _formulas(inputs)
    return by_formula if inputs.scene in ("tube", "strip") else _kept(inputs) | by_formula


def _formulas(inputs: Inputs) -> Truths:
    if inputs.scene == "tube":
        return {"Lame": {"radial displacement": (tube_truth(inputs.wall, inputs.ratio), 0.0)}}
    if inputs.scene == "strip":
        return {"a beam": {"rotation": (1.0, 0.0), "stretch": (1.0, 0.0)}}
    if inputs.scene == "cantilever" and not inputs.is_large:
        deflection = timoshenko_deflection(CANTILEVER_LENGTH, CANTILEVER_LOAD, inputs.ratio)
        return {"Timoshenko": {"tip deflection": (deflection, 0.0)}}
    if inputs.scene == "torsion" and not inputs.is_large:
        return {"Saint-Venant": {"torque": (saint_venant_torque(BAR_LENGTH, TWIST, inputs.ratio), 0.0)}}
    return {}


def _kept(inputs: Inputs) -> Truths:
    """Those of scikit-fem, kept in the system's temporary folder because some take minutes."""
    key = json.dumps([inputs.scene, inputs.ratio, inputs.is_large, VENTRICLE_INNER, VENTRICLE_OUTER])
    here = Path(__file__).parent
    sources = [
        here / f"{name}.py" for name in ("elasticity_truth", "elasticity_scenes", "elasticity_shells", "statics")
    ]
    digest = hashlib.sha256(b"\0".join([key.encode(), *(path.read_bytes() for path in sources)])).hexdigest()
    path = Path(tempfile.gettempdir()) / "heartcase-benchmark-inputs" / f"elasticity-{digest[:24]}.json"
    if path.exists():
        loaded: Truths = json.loads(path.read_text())
        return loaded
    truths = _made_truths(inputs)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(truths))
    return truths


def _made_truths(inputs: Inputs) -> Truths:
    try:
        from benchmarks import elasticity_truth as truth
    except ImportError:
        raise MethodSkipped("it needs scikit-fem: pip install '.[dev]'") from None
    if inputs.scene == "ventricle":
        both = truth.ventricle_truth(VENTRICLE_INNER, VENTRICLE_OUTER, inputs.ratio)
        names = ("apex displacement", "volume change")
        return {"scikit-fem": {name: _pair(one) for name, one in zip(names, both, strict=True)}}
    materials = {"neo-Hooke": "neo_hooke", "our energy": "our_energy"} if inputs.is_large else {"scikit-fem": "linear"}
    name = scene(inputs.scene, inputs.is_large).quantity
    return {
        title: {name: _pair(truth.box_truth(inputs.scene, material, inputs.ratio))}
        for title, material in materials.items()
    }


def _pair(truth: Any) -> tuple[float, float]:
    value, uncertainty = asdict(truth).values()
    return value, uncertainty
