"""The force in a stitch beside the forces at which sutures were measured to cut into or tear out of tissue."""

from __future__ import annotations

from dataclasses import dataclass

from heartcase.schemas.errors import SimulationError

__all__ = ["MEASURED", "MeasuredForce", "StitchFigures", "beside_measured"]

_HARTRUMPF = "Hartrumpf et al., Medicina 2022, 58, 1055, doi 10.3390/medicina58081055"
_MADUKAUWA = "Madukauwa-David et al., Biomech. Model. Mechanobiol. 2019, doi 10.1007/s10237-018-1082-z"


@dataclass(frozen=True)
class MeasuredForce:
    """Forces on one suture that were measured: mean and standard deviation over samples."""

    key: str
    """Name to choose it by."""
    tissue: str
    """What was pulled at."""
    event: str
    """What happened at this force."""
    mean_n: float
    """Mean, N."""
    deviation_n: float
    """Standard deviation, N."""
    source: str
    """Where it was published."""


MEASURED: tuple[MeasuredForce, ...] = (
    MeasuredForce(
        "aortic-cut-in-weakest", "porcine aortic annulus, right coronary region", "cuts in", 4.77, 3.28, _HARTRUMPF
    ),
    MeasuredForce("aortic-cut-in", "porcine aortic annulus, all regions", "cuts in", 9.31, 6.04, _HARTRUMPF),
    MeasuredForce(
        "aortic-tear-out-weakest", "porcine aortic annulus, right coronary region", "tears out", 10.67, 4.04, _HARTRUMPF
    ),
    MeasuredForce("aortic-tear-out", "porcine aortic annulus, all regions", "tears out", 20.41, 10.02, _HARTRUMPF),
    MeasuredForce("tricuspid-weakest", "human tricuspid annulus, anterior region", "tears out", 4.5, 2.6, _MADUKAUWA),
    MeasuredForce("mitral-posterior", "human mitral annulus, posterior region", "tears out", 6.9, 2.6, _MADUKAUWA),
    MeasuredForce("mitral-anterior", "human mitral annulus, anterior region", "tears out", 10.3, 4.7, _MADUKAUWA),
)
"""Published forces on single sutures, in newtons. Pledgeted sutures in annuli: a myocardial wall holds less. None is of
a child's heart."""


@dataclass(frozen=True)
class StitchFigures:
    """One stitch beside a measured force."""

    number: int
    """Number of the stitch in its row."""
    force_n: float
    """Force in it, N."""
    part_of_mean: float
    """Force over the measured mean [1]."""
    deviations_below: float
    """How many standard deviations the force is below the mean; below 0 where it is above."""
    measured: str
    """Key of the measured force."""


def beside_measured(forces_n: tuple[float, ...], key: str = "aortic-cut-in-weakest") -> tuple[StitchFigures, ...]:
    """The forces of a row of stitches beside a measured one.

    Parameters
    ----------
    forces_n
        Force in each stitch, N, not below 0.
    key
        Which measured force; that at which the weakest place cuts in, when left out.

    Raises
    ------
    SimulationError
        There is no such measurement, or a force is below 0 or no number.
    """
    found = next((one for one in MEASURED if one.key == key), None)
    if found is None:
        known = ", ".join(one.key for one in MEASURED)
        raise SimulationError(f"there is no measured force {key!r}: choose from {known}", place="measured")
    if not all(0.0 <= force < float("inf") for force in forces_n):
        raise SimulationError("the force in a stitch must be 0 N or more", place="forces_n")
    return tuple(
        StitchFigures(number, force, force / found.mean_n, (found.mean_n - force) / found.deviation_n, key)
        for number, force in enumerate(forces_n, start=1)
    )
