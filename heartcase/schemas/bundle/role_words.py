"""Whether what should be a role is a person's name: the log of approvals goes with the case to whoever gets it."""

from __future__ import annotations

import re
from itertools import pairwise

__all__ = ["looks_like_a_name"]

_TITLES = frozenset(
    ("dr", "dra", "prof", "mr", "mrs", "ms", "mme", "mlle", "herr", "frau", "signor", "signora", "señor", "señora")
)
"""Words that stand before a name and, with a word behind them, nowhere else."""
_WORDS_OF_ROLES = re.compile(
    "anaesth|anästh|anat|anesth|arzt|assist|attend|ärzt|author|cardi|chief|chirurg|clinic|consult|"
    "curator|develop|direct|doc|engin|expert|fellow|forsch|head|herz|imag|ingen|intern|kardi|kinder|"
    "klinik|leit|lectur|lead|learn|medic|médec|mediz|morpholog|neonat|nurs|operat|pädiat|paediat|"
    "pathol|pediat|perfus|pfleg|phd|physi|prof|radiol|regist|research|resid|review|scien|spez|speci|"
    "stud|surg|teach|team|tech|test|train|user|ward"
)
"""Beginnings or parts of words that say what somebody is, in English, German and French."""
_CAPITALISED = re.compile(r"[A-ZÀ-ÖØ-Þ](?:\.|[a-zß-öø-ÿA-ZÀ-ÖØ-Þ'-]*\.?)")
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
        and all(_CAPITALISED.fullmatch(word) for word in named)
        and not all(word.isupper() and "." not in word for word in named)
        and not any(_says_a_role(word) for word in named)
    )


def _says_a_role(word: str) -> bool:
    return _WORDS_OF_ROLES.search(word.lower()) is not None
