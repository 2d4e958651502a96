"""Sentences of warnings: said, taken apart again, and there in every language of the studio's page."""

import ast
import json
import re
from pathlib import Path

import pytest

import heartcase.pipeline
from heartcase.pipeline.warning_words import SENTENCES, recognised, sentence, value_names
from heartcase.studio.serving.app import PAGE

PIPELINE = Path(heartcase.pipeline.__file__).parent
NUMBERS = {"count": "3", "area": "1,046", "percent": "1.3"}
OF_FILES = ("formats/", "markers/", "building/", "edits/")
"""What is said of files, strokes, locks and edits is told before there is a model, in words of their own."""
ELSEWHERE = {"bundle/assembly.py", "vessel_ends/cut_ends.py", "warnings.py"}
"""Sentences that only a command line meets, or that are put together from what a search found."""


def words_of(language):
    text = (PAGE / "words" / f"warnings_{language}.js").read_text(encoding="utf-8")
    body = text[text.index("{", text.index("export const warnings")) : text.rindex("}") + 1]
    return json.loads(re.sub(r",\s*}$", "}", body))


def sample(template, *, count="3"):
    """A value for each of a template's, as they stand in sentences."""
    return {
        name: count if name == "count" else "12.5" if is_number else f"({name} 1.0, 2.0, 3.0)"
        for name, is_number in re.findall(r"\{(\w+)(#?)\}", template)
    }


@pytest.mark.parametrize("kind", SENTENCES)
@pytest.mark.parametrize("count", ["1", "3"])
def test_every_sentence_is_taken_apart_into_what_it_was_made_of(kind, count):
    values = sample(SENTENCES[kind], count=count)
    text = sentence(kind, **values)
    assert not re.search(r"[{}<>]", text)
    assert recognised(text) == (kind, values)
    about = recognised(f"ends[2] (aorta): {text}")
    # a value that may be anything takes what stands before as well
    assert about.kind == kind
    optional = set(
        re.findall(r"\{(\w+)#?\}", " ".join(re.findall(r"(?<![\[\\])\[([^\[\]]*)\](?!\])", SENTENCES[kind])))
    )
    if optional - set(re.findall(r"\{(\w+)#?\}", re.sub(r"(?<![\[\\])\[[^\[\]]*\](?!\])", "", SENTENCES[kind]))):
        short = {name: value for name, value in values.items() if name not in optional}
        assert recognised(sentence(kind, **short)) == (kind, short)


def test_what_is_no_sentence_of_these_is_none():
    assert recognised("something else: entirely") == ("", {})
    with pytest.raises(KeyError):
        sentence("no-such-kind")
    with pytest.raises(KeyError):
        sentence("stray-pieces", label="aorta")


SETTINGS = re.compile(r"[a-z]+_mm\b|walls\.|surface\.|\[\[\w|\\\\\[|'ends'|heartcase suggest|septal_defect")
"""Names in a recipe's file, and commands."""


def test_what_names_settings_of_a_recipe_has_words_of_the_page():
    words = words_of("en")
    assert {kind for kind, text in SENTENCES.items() if SETTINGS.search(text)} <= words.keys() <= SENTENCES.keys()
    assert not [kind for kind, text in words.items() if SETTINGS.search(text)]


@pytest.mark.parametrize("language", ["de", "en"])
def test_every_kind_has_both_languages_and_says_the_same_values(language):
    words = words_of(language)
    assert language == "en" or words.keys() == SENTENCES.keys()
    for kind, text in words.items():
        missing = value_names(SENTENCES[kind]) - value_names(text)
        # numbers that are to be written into a recipe are for those who write one
        assert missing <= {"numbers"}, (kind, missing)
        assert value_names(text) <= value_names(SENTENCES[kind]), kind
        assert text.count("[") == text.count("]"), kind


def test_no_warning_of_a_model_is_said_in_words_of_its_own():
    found = []
    for file in sorted(PIPELINE.rglob("*.py")):
        name = file.relative_to(PIPELINE).as_posix()
        if name.startswith(OF_FILES) or name in ELSEWHERE:
            continue
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            is_call = isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
            if is_call and node.func.id in ("CaseWarning", "anatomy", "note") and node.args:
                first = node.args[0]
                if isinstance(first, ast.JoinedStr) or (isinstance(first, ast.Constant) and first.value):
                    found.append(f"{name}:{node.lineno}")
    assert found == []
