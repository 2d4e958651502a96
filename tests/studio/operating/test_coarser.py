"""Coarser levels of detail follow what is cut, and are sent to the page that wants them."""

import numpy as np
import pytest

from heartcase.schemas.recording.commands import Cut
from heartcase.simulator.live.shapes import CUT_FACES
from heartcase.simulator.surface.deform import deform
from heartcase.studio.operating.scene.coarser import CoarserWorker, load_coarser
from tests.simulator.live.scenes import live_on, load, until
from tests.studio.operating.boxes import write_block_with_a_box
from tests.studio.operating.performing import operator, theatre, unpacked

BLOCK_MM = np.array([24.0, 15.0, 12.0])
ACROSS = ((22.1, -30.0, 20.0), (22.1, -30.0, 60.0)), ((22.1, 10.0, 20.0), (22.1, 10.0, 60.0))
"""A blade that parts the block along x, from side to side."""


def volume_and_cut_area(live, surface, structures):
    places = deform(live.frame.model, surface, live.frame.state.displacement).vertices_mm.astype(float)
    corners = places[surface.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = np.einsum("tx,tx->", corners[:, 0] - places.mean(axis=0), across) / 6.0
    return volume, 0.5 * np.linalg.norm(across[structures == CUT_FACES], axis=1).sum(), places


@pytest.fixture(scope="module")
def boxed(tmp_path_factory):
    return write_block_with_a_box(tmp_path_factory.mktemp("boxed"))


def test_a_coarser_level_is_cut_as_the_finest_is_and_stays_closed(boxed):
    live = live_on(load(boxed))
    (box,) = load_coarser(boxed)
    assert box.level == 1
    assert len(box.surface.triangles) == 12
    worker = CoarserWorker((box,), lambda: None)
    try:
        worker.ask(live.newest)
        until(lambda: worker.newest is not None and worker.newest[0] is live.newest.surface)
        assert worker.newest[1] == (box,)
        live.do(Cut(name="blade", poses_mm=ACROSS))
        until(lambda: (live.tick(), live.newest.tissue_cuts is not None)[1])
        worker.ask(live.newest)
        until(lambda: worker.newest[0] is live.newest.surface)
        (cut,) = worker.newest[1]
        volume, area, places = volume_and_cut_area(live.newest, cut.surface, cut.structures)
        # both lips of a plane across, whatever the triangles are
        assert volume == pytest.approx(BLOCK_MM.prod(), rel=1e-5)
        assert area == pytest.approx(2.0 * BLOCK_MM[1] * BLOCK_MM[2], rel=1e-5)
        # each part follows nodes of its own
        is_left = np.isin(np.arange(len(places)), cut.surface.triangles) & (places[:, 0] < 22.0)
        nodes = cut.surface.triangle_nodes
        assert np.intersect1d(nodes[is_left], nodes[places[:, 0] > 22.2]).size == 0
    finally:
        worker.close()
        live.close()


def test_a_page_that_wants_them_is_sent_them_once_for_each_topology_also_while_time_stands(boxed, tmp_path):
    sent = []
    with theatre(boxed, tmp_path) as (browser, opened), operator(browser, opened) as page:
        take = page._take

        def look(data):
            header, arrays = unpacked(data)
            if header["kind"] == "coarse_topology":
                sent.append((header, arrays, page.topology[0]["topology"]))
            else:
                take(data)

        page._take = look
        page.until(lambda frame: frame["step"] > 0)
        page.done("pause", paused=True)
        page.until(lambda frame: frame["mode"] == "paused")
        assert sent == []
        page.done("coarser")
        while not sent:
            page.next()
        header, arrays, topology = sent[0]
        assert (header["level"], header["topology"], len(arrays["triangles"])) == (1, topology, 12)
        page.done("pause", paused=False)
        page.done("command", command={"kind": "cut", "name": "blade", "poses_mm": ACROSS})
        while len(sent) < 2:
            page.next()
        header, arrays, topology = sent[1]
        assert header["topology"] == topology > sent[0][2]
        assert (arrays["structure"] == CUT_FACES).any()
        assert len(sent) == 2
