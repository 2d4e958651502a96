"""Messages of a session by their kind: what is raised is recognised, and each kind has a German sentence."""

import re
from pathlib import Path

import pytest

import heartcase
from heartcase.schemas.errors import SimulationError
from heartcase.schemas.recording.commands import CloseGrab, LeadGrab
from heartcase.simulator.case_simulation import simulation_of_case
from heartcase.simulator.live.live import Live
from heartcase.simulator.load import load_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.studio.message_words import MESSAGES, problem_facts, value_names
from heartcase.studio.messages import problems_of
from heartcase.studio.serving.app import PAGE
from tests.simulator.live.scenes import write_case
from tests.simulator.session.sessions import block_simulation
from tests.studio.raised_texts import marked, raised, said

PACKAGE = Path(heartcase.__file__).parent
SAID_BY = ("schemas", "simulator", "studio/operating", "studio/offline", "studio/painting")
"""Folders whose texts a page may be told."""
OPERATE_CALLS = (
    "schemas/recording",
    "simulator/background",
    "simulator/cutting",
    "simulator/instruments",
    "simulator/live",
    "simulator/patching",
    "simulator/session",
    "simulator/suturing",
    "simulator/tissue",
    "simulator/simulation.py",
    "studio/operating",
)
"""What Operate asks to do something; figures, devices and tours have more to say, which stays English."""
CALLED_BY_OTHERS = {
    "checked.py",
    "planned_incisions.py",
    "script.py",
    "script_tools.py",
    "snapshots.py",
    "templates.py",
}
"""Of these, what other programs and the command line alone call: scripts, plans, templates, settings."""
STAYS_ENGLISH = {
    # arguments of a command that the schema of commands refuses before, or that no page sends
    "a blade needs two points or more in two poses or more, shape (poses, points, 3)",
    "a place must be three finite numbers",
    "a row lies between two chosen stitches at least",
    "a spacing of {} mm cannot be: give one above 0",
    "a stiffness of {} N/m cannot be: give one above 0",
    "a stitch has two places (found {})",
    "a thread cannot be drawn with {} N: give 0 N or more",
    "a thread of {} mm cannot be: give 0 mm or more",
    "every point must be three finite numbers within the lattice",
    "every point of a blade must be three finite numbers",
    "give either a length in mm or a tension in N",
    "only a ball is swept along an axis: give one radius",
    "the axis must be three finite numbers",
    "the centre and the radius must be finite numbers, three and one",
    "the centre must be three finite numbers",
    "the gap between the jaws must be above 0 mm (found {})",
    "the hinge must be three finite numbers",
    "the jaws close to 0 and open to {} degrees",
    "the jaws open by more than 0 and at most 90 degrees (found {})",
    "the length must be above 0 mm (found {})",
    "the offset must be three finite numbers",
    "the radius must be above 0 mm (found {})",
    "the side must be three finite numbers, not all zero",
    "the tip must be three finite numbers",
    "the turn must be a rotation matrix, shape (3, 3)",
    "the {} must be above 0 (found {})",
    "the {} must be above 0 mm (found {})",
    "the {} must be three finite numbers, not all zero",
    "there is no such patch",
    "there is no tool {}",
    "{} (found {})",
    "{} must be above 0 (is {})",
    # what is given as an object, or set, by other programs alone
    "a damping of {}/s: give 0 to less than {}/s, one over the step",
    "a movement of {} mm cannot be left out: give 0 or more",
    "no forceps of this kind hold tissue: close them first",
    "no state is stored where {} entries are done; there are: {}",
    "no such scissors are here: bring them in first",
    "step {} cannot be played to: there are {} to {}",
    "the hand has let go, or is not of this simulation: grab again",
    "the patch was taken out",
    "the path holds a character that no path may hold",
    "the probe was withdrawn and cannot be moved: bring in another",
    "the session began with a lattice that was cut or joined: record from before that",
    "the session has a history already: load a recording into a new one",
    "the session is being recorded already",
    "the session moves another lattice than that of {}: give its own",
    "the session went from step {} to {} and took over at none like {}",
    "the stitch was taken out: place another",
    "this is no grab but a {}: give what grab() returned",
    "this is no instrument but a {}: give what grab() or probe() returned",
    "this is no probe but a {}: give what probe() returned",
    "this is no snapshot but a {}: give what snapshot() returned",
    "this is of another lattice: restore what this simulation gave",
    "this place is in another lattice: give it in mm",
    "{} frames are more than {}: {}",
    "{} s between states: give more than 0",
    # springs that other programs join or remove
    "explicit springs hang on so little tissue after this cut that they are too stiff for the time step: remove them "
    "first, or take a smaller step",
    "explicit springs hold this piece: take them out first",
    "springs of this lattice were removed: cut it by blades only",
    "springs of this lattice were removed: cut it by sheets only",
    "the tissue was cut: cut it by blades only",
    "there are {} explicit springs, from 0: name one of them",
    "there are {} springs: give one value for each",
}
"""What the modules that Operate calls raise, and no page is told."""


def files_of(*places):
    """The sources of some folders, and some files."""
    found = [PACKAGE / place for place in places]
    return [file for one in found for file in (sorted(one.rglob("*.py")) if one.is_dir() else [one])]


def test_every_kind_is_what_is_said_somewhere():
    texts = said(files_of(*SAID_BY))
    assert [code for code, template in MESSAGES.items() if marked(template) not in texts] == []
    # each a sentence of pieces that are said, and said nowhere
    invented = ("the heart {a#} the tissue {b#} mm; all of it", "session {name}: the case", "it is recorded")
    assert not texts & {marked(one) for one in invented}


def test_what_operate_may_be_refused_has_a_kind():
    kinds = {marked(template) for template in MESSAGES.values()}
    found = raised([file for file in files_of(*OPERATE_CALLS) if file.name not in CALLED_BY_OTHERS])
    texts = {one.text for one in found}
    assert len(kinds & texts) > 80, "the raises were not found"
    assert [one for one in found if one.text not in kinds | STAYS_ENGLISH] == []
    assert STAYS_ENGLISH - texts == set()
    assert STAYS_ENGLISH & kinds == set()


def test_every_kind_has_a_german_sentence_with_its_values():
    german = (PAGE / "words" / "messages_de.js").read_text(encoding="utf-8").partition("places")[0]
    sentences = {one[1]: one[2] for one in re.finditer(r'^  "?([a-z-]+)"?: "(.+)",$', german, re.MULTILINE)}
    assert list(sentences) == list(MESSAGES)
    for code, sentence in sentences.items():
        assert value_names(sentence) <= value_names(MESSAGES[code]), code


@pytest.mark.parametrize("code", MESSAGES)
def test_every_kind_is_recognised(code):
    values = dict.fromkeys(value_names(MESSAGES[code]), "12.5")
    text = re.sub(r"\{(\w+)[#*]?\}", lambda found: values[found[1]], MESSAGES[code])
    assert problem_facts("here", text) == {"place": "here", "message": text, "code": code, "values": values}


def test_what_no_kind_fits_is_told_as_it_is():
    assert problems_of(SimulationError("odd", place="x")) == [{"place": "x", "message": "odd"}]


def test_words_of_a_kind_in_a_message_are_told_by_their_kind():
    lost = problem_facts("haptics", "the haptic loop has ended: it was killed; make another; its hand lets go softly")
    assert lost["code"] == "device-lost"
    assert lost["values"]["why"]["code"] == "haptics-ended"
    assert lost["values"]["why"]["values"]["why"] == {"message": "it was killed", "code": "device-killed", "values": {}}
    # what no kind fits stays text, and a name is never taken for a message
    odd = problem_facts("", "odd; its hand lets go softly")
    assert odd["values"] == {"why": "odd"}
    assert problem_facts("", "recorded in it was killed")["values"] == {"name": "it was killed"}


def test_what_ends_a_simulation_is_told_in_full():
    session = OperatingSession(block_simulation(damping_per_s=0.0))
    session.do(CloseGrab(name="hand 1", center_mm=(2, 4, 8), radius_mm=3))
    session.do(LeadGrab(name="hand 1", offset_mm=(1e30, 1e30, 1e30)))
    told = problem_facts("simulation", session.take([], 5).breakdown)
    assert told["code"] == "broke-down"
    held = told["values"]["trouble"]
    assert (held["code"], held["values"]["names"]) == ("trouble-held", "hand 1")
    assert held["values"]["trouble"]["code"] == "trouble-number"


def test_what_a_session_says_is_recognised(tmp_path):
    session = OperatingSession(simulation_of_case(load_case(write_case(tmp_path), needs=("surface", "tissue"))))
    live = Live(session)
    live.record(tmp_path / "one.recording")
    live.tick()
    live.stop_recording()
    live.tick()
    begun, done = (problem_facts(one.place, one.message) for one in live.take_messages())
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
