"""Whether what should be a role is a person's name: the log of approvals goes with the case to whoever gets it."""

from __future__ import annotations

import re
from itertools import pairwise

__all__ = ["looks_like_a_name"]

_TITLES = frozenset(
    ("dr", "dra", "prof", "mr", "mrs", "ms", "mme", "mlle", "herr", "frau", "signor", "signora", "señor", "señora")
)
"""Words that stand before a name and, with a word behind them, nowhere else."""
_STEMS = (
    "anaesth|anästh|anesth|assist|attend|cardi|clinic|consult|curator|develop|forsch|kardi|klinik|lectur|medic|médec|"
    "mediz|morpholog|neonat|operat|pädiat|paediat|pathol|pediat|perfus|pfleg|physi|radiol|regist|research|resid|review|"
    "scien|spezial|special|surg"
)
_WHOLE = (
    "anatom(?:y|ist|ie)|arzt|ärztin|author|chief|chef|director|doctor|docteur|doctoral|doctorand|doktorand(?:in)?|"
    "engineer|engineering|expert|expertin|fellow|head|herz|imaging|ingenieur(?:in)?|intern(?:e|ist|istin)?|kinder|"
    "lead|leader|leading|learner|leit(?:er|erin|ende|ender|ung)|nurs(?:e|ing)|phd|prof|professor(?:in)?|stud(?:ent|entin|y)|"
    "studienarzt|teach(?:er|ing)|team|tech(?:nician|nologist|nical|niker|nikerin)|test(?:er|ing)?|"
    "train(?:ee|er|ing)|user|ward"
)
_COMPOUNDS = "kardiolog|chirurg|anästhes|radiolog|mediziner|ärztin|arzt|pfleger"
_SAYS_A_ROLE = re.compile(f"(?:{_STEMS}).*|(?:{_WHOLE})|.*(?:{_COMPOUNDS}).*")
"""Words that say what somebody is, in English, German and French: by their beginning where no name begins so, else
whole; and what stands inside of German compounds."""
_OF_NAMES = frozenset(("van", "von", "der", "den", "de", "da", "di", "du", "del", "la", "le", "bin", "al"))
_OF_ROLES = frozenset(("of", "in", "for", "and"))


def looks_like_a_name(role: str) -> bool:
    """Whether a text is probably a name: ``Dr. John Smith``, ``J. Smith``, ``Smith, John``.

    A title with a word behind it always is one. Two to four words in capitals are one where none of them says what
    somebody is, so that what is no name can be written in small letters. A single word is taken for a role.
    """
    words = re.findall(r"[^\s,;/()]+", role)
    for word, after in pairwise(words):
        is_title = any(part in _TITLES for part in word.lower().split("."))
        if is_title and after.lower() not in _OF_ROLES and not _says_a_role(after):
            return True
    named = [word for word in words if word.lower() not in _OF_NAMES]
    return (
        2 <= len(named) <= 4
        and all(_is_capitalised(word) for word in named)
        and not all(word.isupper() and "." not in word for word in named)
        and not any(_says_a_role(word) for word in named)
    )


def _is_capitalised(word: str) -> bool:
    return word[:1].isupper() and all(letter.isalpha() or letter in "'\u2019.-" for letter in word)


def _says_a_role(word: str) -> bool:
    return any(_SAYS_A_ROLE.fullmatch(part) for part in word.lower().rstrip(".").split("-"))
