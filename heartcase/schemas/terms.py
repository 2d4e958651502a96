"""The vocabulary of the heart: what a structure is called here, in SNOMED CT, and in the programs that segment it.

Chambers are named by morphology, that is by what they are and not by the side they lie on: in a heart with swapped
ventricles the morphologically right ventricle lies on the left. Each code is in the standard or the table that its
term names as source; a structure whose code is in neither has none.

Sources: DICOM PS3.16 context groups (CID 3630, 4042, 7152, 12305); the SNOMED mapping of TotalSegmentator 2; the
general anatomy terminology of 3D Slicer; Pace et al., HVSMR-2.0, Scientific Data 11 (2024), doi
10.1038/s41597-024-03469-9.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

__all__ = [
    "CONVENTIONS",
    "TERMS",
    "Term",
    "as_markdown",
    "contradicts",
    "is_of_another_version",
    "normalised",
    "term_by_code",
    "term_by_name",
]


@dataclass(frozen=True)
class Term:
    """One structure."""

    name: str
    """What heartcase calls it."""
    code: str | None = None
    """SNOMED CT concept identifier; None where none was found in a public source."""
    meaning: str = ""
    """What the code's source calls it (the DICOM code meaning)."""
    source: str = ""
    """Where the code is written down."""
    synonyms: tuple[str, ...] = ()
    """Other names, in lower case with single spaces."""


_DICOM = "DICOM PS3.16 CID"

TERMS: tuple[Term, ...] = (
    Term(
        "morphologically left ventricle",
        "87878005",
        "Left ventricle",
        f"{_DICOM} 7152",
        ("left ventricle", "left ventricle of heart", "heart ventricle left", "left ventricular cavity", "lv"),
    ),
    Term(
        "morphologically right ventricle",
        "53085002",
        "Right ventricle",
        f"{_DICOM} 7152",
        ("right ventricle", "right ventricle of heart", "heart ventricle right", "right ventricular cavity", "rv"),
    ),
    Term(
        "morphologically left atrium",
        "82471001",
        "Left atrium",
        f"{_DICOM} 3630",
        ("left atrium", "left atrium of heart", "heart atrium left", "la"),
    ),
    Term(
        "morphologically right atrium",
        "73829009",
        "Right atrium",
        f"{_DICOM} 3630",
        ("right atrium", "right atrium of heart", "heart atrium right", "ra"),
    ),
    Term(
        "morphologically left ventricular myocardium",
        "49848007",
        "Left Ventricle Myocardium",
        f"{_DICOM} 12305",
        ("left ventricular myocardium", "left ventricle myocardium", "myocardium of left ventricle", "lv myocardium"),
    ),
    Term(
        "morphologically right ventricular myocardium",
        synonyms=(
            "right ventricular myocardium",
            "right ventricle myocardium",
            "myocardium of right ventricle",
            "rv myocardium",
        ),
    ),
    Term("myocardium", "74281007", "Myocardium", "TotalSegmentator", ("heart myocardium", "heart muscle")),
    Term("aorta", "15825003", "Aorta", f"{_DICOM} 7152", ("ao",)),
    Term("pulmonary artery", "81040000", "Pulmonary artery", f"{_DICOM} 3630", ("pulmonary arteries", "pa")),
    Term("superior vena cava", "48345005", "Superior vena cava", f"{_DICOM} 3630", ("svc",)),
    Term("inferior vena cava", "64131007", "Inferior vena cava", f"{_DICOM} 3630", ("ivc",)),
    Term("pulmonary vein", "122972007", "Pulmonary vein", f"{_DICOM} 3630", ("pulmonary veins", "pv")),
    Term("coronary sinus", "90219004", "Coronary sinus", f"{_DICOM} 3630", ("cs",)),
    Term(
        "left atrial appendage",
        "33626005",
        "Left auricular appendage",
        f"{_DICOM} 4042",
        ("left auricular appendage", "atrial appendage left", "laa"),
    ),
    Term(
        "right atrial appendage",
        "68300000",
        "Right auricular appendage",
        f"{_DICOM} 4042",
        ("right auricular appendage", "atrial appendage right", "raa"),
    ),
)
"""Every structure that is known by name. "myocardium" alone does not say of which ventricle."""

CONVENTIONS: dict[str, dict[int, str]] = {
    "hvsmr-2.0": {1: "LV", 2: "RV", 3: "LA", 4: "RA", 5: "AO", 6: "PA", 7: "SVC", 8: "IVC"},
    "totalsegmentator-heartchambers": {
        1: "heart_myocardium",
        2: "heart_atrium_left",
        3: "heart_ventricle_left",
        4: "heart_atrium_right",
        5: "heart_ventricle_right",
        6: "aorta",
        7: "pulmonary_artery",
    },
    "totalsegmentator-total-v2": {
        52: "aorta",
        53: "pulmonary_vein",
        61: "atrial_appendage_left",
        62: "superior_vena_cava",
        63: "inferior_vena_cava",
    },
}
"""Value -> name in label volumes that hold numbers alone: of HVSMR-2.0, and of TotalSegmentator 2's tasks
``heartchambers_highres`` and ``total``. The latter's 51 is the whole heart, which is no single structure; version 1
numbered otherwise (44 to 49 the heart's parts, 52 an iliac artery)."""
TOTAL_V2 = "totalsegmentator-total-v2"


def normalised(name: str) -> str:
    """A name as it is compared: lower case, without spaces, underscores and hyphens."""
    return re.sub(r"[\s_-]+", "", name.casefold())


_BY_NAME = {normalised(name): term for term in TERMS for name in (term.name, *term.synonyms)}
_BY_CODE = {term.code: term for term in TERMS if term.code is not None}


def term_by_name(name: str) -> Term | None:
    """The structure that has this name or synonym; None where none has."""
    return _BY_NAME.get(normalised(name))


def term_by_code(code: str) -> Term | None:
    """The structure with this SNOMED CT code; None where none has it."""
    return _BY_CODE.get(code)


def contradicts(name: str, code: str) -> bool:
    """Whether a name and a SNOMED CT code stand for different structures; no if one of them is not in the vocabulary.

    "Myocardium" alone goes with the myocardium of either ventricle.
    """
    named, coded = term_by_name(name), term_by_code(code)
    if named is None or coded is None or named is coded:
        return False
    is_general = "myocardium" in (named.name, coded.name)
    return not (is_general and named.name.endswith("myocardium") and coded.name.endswith("myocardium"))


def is_of_another_version(convention: str, voxel_counts: Mapping[int, int]) -> bool:
    """Whether a label volume seems to follow an older numbering than the convention that is claimed for it.

    In version 2 of TotalSegmentator 44 to 49 are vertebrae of the neck, each far smaller than 51, the heart. In version
    1 they are the myocardium, the chambers and the pulmonary artery, and 51 is an iliac artery (Wasserthal et al.,
    Radiology: Artificial Intelligence 5 (2023), doi 10.1148/ryai.230024, and its table of classes).

    Parameters
    ----------
    convention
        Key of :data:`CONVENTIONS`.
    voxel_counts
        Value -> number of voxels that have it.
    """
    largest = max(voxel_counts.get(value, 0) for value in range(44, 50))
    return convention == TOTAL_V2 and largest > voxel_counts.get(51, 0)


def as_markdown() -> str:
    """The vocabulary as a table, for docs/labels.md: run ``python -m heartcase.schemas.terms``."""
    lines = ["| structure | SNOMED CT | its name there | written down in | other names |", "|---|---|---|---|---|"]
    for term in TERMS:
        cells = (term.name, term.code or "none found", term.meaning, term.source, ", ".join(term.synonyms))
        lines.append(f"| {' | '.join(cells)} |")
    lines += ["", "| values of | stand for |", "|---|---|"]
    for convention, values in CONVENTIONS.items():
        lines.append(f"| `{convention}` | {', '.join(f'{value} {name}' for value, name in values.items())} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(as_markdown(), end="")
