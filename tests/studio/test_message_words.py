"""Messages of a session by their kind: what is raised is recognised, and each kind has a German sentence."""

import ast
import re
from pathlib import Path

import pytest

import heartcase
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.case_simulation import simulation_of_case
from heartcase.simulator.live.live import Live
from heartcase.simulator.load import load_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.studio.message_words import MESSAGES, problem_facts, value_names
from heartcase.studio.messages import problems_of
from heartcase.studio.serving.app import PAGE
from tests.simulator.live.scenes import write_case

SOURCES = [
    Path(heartcase.__file__).parent / folder
    for folder in ("schemas", "simulator", "studio/operating", "studio/offline", "studio/painting")
]


def texts():
    """All texts of the sources, what stands for a value as a line break."""
    found = []
    for file in (file for folder in SOURCES for file in folder.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.JoinedStr):
                found += [one.value for one in node.values if isinstance(one, ast.Constant)]
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                found += re.split(r"\{[^}]*\}", node.value)
    return "\n".join(found)


def test_every_kind_is_said_somewhere():
    said = texts()
    for code, template in MESSAGES.items():
        for part in re.split(r"\{\w+#?\}", template):
            # what several texts make together is looked for in pieces
            assert all(piece in said for piece in re.split(r"[;:.] ", part.strip())), (code, part)


def test_every_kind_has_a_german_sentence_with_its_values():
    german = (PAGE / "words" / "messages_de.js").read_text(encoding="utf-8").partition("places")[0]
    sentences = {one[1]: one[2] for one in re.finditer(r'^  "?([a-z-]+)"?: "(.+)",$', german, re.MULTILINE)}
    assert list(sentences) == list(MESSAGES)
    for code, sentence in sentences.items():
        assert value_names(sentence) <= value_names(MESSAGES[code]), code


@pytest.mark.parametrize("code", MESSAGES)
def test_every_kind_is_recognised(code):
    values = dict.fromkeys(value_names(MESSAGES[code]), "12.5")
    text = re.sub(r"\{(\w+)#?\}", lambda found: values[found[1]], MESSAGES[code])
    assert problem_facts("here", text) == {"place": "here", "message": text, "code": code, "values": values}


def test_what_no_kind_fits_is_told_as_it_is():
    assert problems_of(SimulationError("odd", place="x")) == [{"place": "x", "message": "odd"}]


def test_what_a_session_says_is_recognised(tmp_path):
    session = OperatingSession(simulation_of_case(load_case(write_case(tmp_path), needs=("surface", "tissue"))))
    live = Live(session)
    live.record(tmp_path / "one.recording")
    live.tick()
    live.stop_recording()
    live.tick()
    begun, done = (problem_facts(said.place, said.message) for said in live.take_messages())
    assert (begun["code"], begun["values"]) == ("recording-begun", {"name": "one.recording"})
    assert done["code"] == "recording-done"
    for wrong, code in (
        (session.undo, "nothing-to-undo"),
        (session.redo, "nothing-to-redo"),
        (lambda: session.simulation.grab((500.0, 0.0, 0.0), 2.0), "grab-nothing"),
        (lambda: session.simulation.excise((22.0, -14.0, 40.5)), "excise-nothing-cut"),
    ):
        with pytest.raises(SimulationError) as refused:
            wrong()
        assert problems_of(refused.value)[0].get("code") == code, refused.value
    live.close()
