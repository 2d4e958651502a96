"""What a tour shows and does on a case, by places that the case's own shape tells."""

from __future__ import annotations

import re

import numpy as np
import pytest

from heartcase.cli.main import main
from heartcase.pipeline.bundle.write_bundle import write_bundle
from heartcase.schemas.recording.commands import BringProbe, Cut, MoveProbe, OpenGrab, PlacePatch, TieStitch
from heartcase.schemas.touring.reading import parse_tour
from heartcase.simulator.load import load_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.simulation import Simulation
from heartcase.simulator.touring.case_places import CasePlaces
from heartcase.simulator.touring.running import run_timed
from heartcase.simulator.touring.staging import staged_scenes, timed_commands
from tests.hollow_case import CELL_MM, WALL, hollow_case
from tests.simulator.touring.hollow_tour import TOUR


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("touring")
    write_bundle(path / "hollow.case", hollow_case())
    (path / "hollow.tour.md").write_text(TOUR)
    return path


@pytest.fixture(scope="module")
def places(folder):
    return CasePlaces(load_case(folder / "hollow.case", needs=("surface", "structures", "tissue")))


def index(places, point):
    """Place in cells, from the box's lowest corner."""
    return places.case.model.geometry.world_to_index(np.asarray(point)[None])[0] + 0.5


def test_views_are_where_the_places_are(places):
    scenes = staged_scenes(parse_tour(TOUR), places)
    hole, lid = scenes[1].view, scenes[3].view
    np.testing.assert_allclose(index(places, hole.target_mm), [6, 5, WALL + 1], atol=1e-6)
    np.testing.assert_allclose(hole.towards, [0, 0, 1], atol=1e-6)
    # from above the patient's front is up, and the right on the right
    np.testing.assert_allclose(hole.up, [0, -1, 0], atol=1e-6)
    # straight at the lid is from outside
    np.testing.assert_allclose(lid.towards, [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(index(places, lid.target_mm)[2], 8.0, atol=1e-6)
    plane = scenes[1].plane
    np.testing.assert_allclose(plane.normal, [0, 0, 1], atol=1e-6)
    # it is led by a place at the lower edge of the view
    np.testing.assert_allclose(np.subtract(plane.point_mm, hole.target_mm), [0, 0.42 * 30, 6], atol=1e-6)
    # the view stays where a step has none, and all else does not
    assert scenes[4].view == lid
    assert scenes[2].plane is None
    assert scenes[0].view.up == (0.0, 0.0, 1.0)


def test_what_is_named_is_shown_or_hidden_with_its_wall(places):
    text = TOUR.replace('[view]\nfrom = "front"\n', 'show = ["left ventricular myocardium"]\n')
    labels = {label.name: label.value for label in places.case.manifest.labels}
    hidden = set(staged_scenes(parse_tour(text), places)[0].hidden)
    own = next(value for name, value in labels.items() if "myocardium" in name)
    assert hidden == set(labels.values()) - {own}
    text = TOUR.replace('[view]\nfrom = "front"\n', 'hide = ["RV", "cut faces"]\n')
    hidden = set(staged_scenes(parse_tour(text), places)[0].hidden)
    found = {value for name, value in labels.items() if name.startswith("morphologically right ventricle")}
    assert len(found) == 2
    assert hidden == found | {256}


def test_commands_go_where_they_shall(places):
    tour = parse_tour(TOUR)
    through = timed_commands(tour, 2, places)
    brought = through[0]
    assert isinstance(brought, BringProbe)
    way = [one.center_mm[2] for one in through if isinstance(one, MoveProbe)]
    middle = places.point("hole")[2]
    assert brought.center_mm[2] == pytest.approx(middle + 6.0)
    assert way[-1] == pytest.approx(middle - 4.0)
    assert way == sorted(way, reverse=True)
    opened = timed_commands(tour, 3, places)
    cut = next(one for one in opened if isinstance(one, Cut))
    heights = np.array(cut.poses_mm)[..., 2] - places.rest_mm[:, 2].max()
    assert cut.at_rest
    assert (heights[:, 0] > 0.0).all()
    assert (heights[:, 1] < -CELL_MM).all()
    patch = next(one for one in timed_commands(tour, 4, places) if isinstance(one, PlacePatch))
    beside = np.abs(np.array(patch.outline_mm)[:, :2] - places.point("hole")[:2]).max(axis=0)
    np.testing.assert_allclose(beside, [2 * CELL_MM, 2 * CELL_MM], atol=2.5)
    closed = timed_commands(tour, 5, places)
    assert [one.name for one in closed if isinstance(one, OpenGrab)] == ["lid one lip", "lid other lip"]
    assert any(isinstance(one, TieStitch) for one in closed)


def test_a_tour_is_played_to_its_end(places):
    tour, case = parse_tour(TOUR), places.case
    session = OperatingSession(Simulation(case.model, surface=case.surface, tissue=case.tissue, damping_per_s=30.0))
    widest, frames = 0.0, []
    for number in range(len(tour.steps)):
        run_timed(session, timed_commands(tour, number, places), on_frame=frames.append)
        if number == 3:
            hands = [one.center_mm for one in session.frame().instruments.values()]
            widest = float(np.linalg.norm(hands[0] - hands[1]))
    assert widest > 2 * CELL_MM
    end = session.frame()
    assert not end.instruments
    assert list(end.patches) == ["patch"]
    assert end.stitches
    assert all(one.is_tied for one in end.stitches.values())
    assert session.simulation.inverted_cell_count() == 0
    assert len(frames) > 15
    # closed again: the lips are near to where they were
    assert float(np.abs(end.displacement_mm[: case.model.node_count]).max()) < CELL_MM


def test_the_command_line_does_all_of_it(folder, capsys):
    assert main(["validate", str(folder / "hollow.tour.md"), "--case", str(folder / "hollow.case"), "--run"]) == 0
    assert capsys.readouterr().out == "sound\n"
    wrong = folder / "wrong.tour.md"
    text = TOUR.replace('kind = "withdraw_probe"\nname = "probe"', 'kind = "withdraw_probe"\nname = "prob"')
    wrong.write_text(f'{text}\n## Last\n\nLet go.\n\n```toml\n[[do]]\nkind = "open_grab"\nname = "nobody"\n```\n')
    assert main(["validate", str(wrong), "--case", str(folder / "hollow.case"), "--run"]) == 1
    told = capsys.readouterr().out
    assert "(step 4)" in told
    # steps after one that fails are done, too
    assert f"(step {text.count(chr(10) + '## ') + 1})" in told
    assert re.search(r"warning: what steps after line \d+ \(step 4\) could not do may follow", told)
