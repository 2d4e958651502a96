"""Drafts that are dropped on a page, through the studio's server."""

import gzip
import json
import struct
import threading
import zlib
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import SimpleITK

from heartcase.pipeline.building.session_file import open_session
from heartcase.pipeline.formats.read_scan import read_labels
from heartcase.schemas.errors import MarkerError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.recipe import load_recipe
from heartcase.studio.painting import drafts
from tests.studio.talking import ADDRESS, page, studio, write_recipe


@pytest.fixture
def recipe(tmp_path):
    return write_recipe(tmp_path)


def packed(files, **options):
    header = json.dumps({"files": [{"name": name, "size": len(data)} for name, data in files]} | options).encode()
    return len(header).to_bytes(4, "little") + header + b"".join(data for _, data in files)


def volume(path, name="draft.nii.gz", values=None):
    """A label file on the recipe's scan: two blocks, of the left ventricle and of the aorta, or something else."""
    scan = SimpleITK.ReadImage(str(path.parent / "scan.nii.gz"))
    if values is None:
        values = np.zeros(scan.GetSize()[::-1], np.uint8)
        values[1:4, 2:6, 2:6] = 1
        values[4:7, 5:9, 6:11] = 5
    image = SimpleITK.GetImageFromArray(values)
    image.CopyInformation(scan)
    file = path.parent.parent / f"elsewhere_{name}"
    SimpleITK.WriteImage(image, str(file))
    data = file.read_bytes()
    file.unlink()
    return data, values


def send(browser, body, **headers):
    return browser.post(f"/draft/{browser.opened.key}", content=body, headers={"origin": ADDRESS} | headers)


def names(folder):
    return sorted(one.name for one in folder.iterdir())


def test_a_draft_is_written_shown_taken_back_and_there_after_a_restart(recipe):
    path, middle = recipe
    text = path.read_bytes()
    data, values = volume(path)
    with studio(path) as browser, page(browser) as talker, page(browser) as other:
        talker.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])
        talker.ask(do="end")
        before = talker.labels.copy()
        assert send(browser, packed([("Surname^Forename.nii.gz", data)])).json() == {"problems": []}
        for one in (talker, other):
            one.hear("opened")
            one.ask(do="end")
        # the recipe says it, by a name that tells nothing
        opened = load_recipe(path)
        assert [file.path for file in opened.markers] == ["draft_1.nii.gz"]
        assert (path.parent / "draft_1.nii.gz").read_bytes() == data
        assert "Surname" not in path.read_text()
        wanted = open_session(path, out=path.parent / "out").session
        is_marked = (values != 0) & (wanted.marked != 5)
        np.testing.assert_array_equal(wanted.marked[is_marked], values[is_marked])
        for one in (talker, other):
            np.testing.assert_array_equal(one.labels, wanted.labels)
        assert (talker.labels != before).any()
        # a second one, as a draft of which the cores count
        again = packed([("x.nii.gz", data)], core_mm=1.5, background=True, ignores_others=True)
        assert send(browser, again).json() == {"problems": []}
        talker.hear("opened")
        said = load_recipe(path).markers[-1]
        assert (said.path, said.core_mm, said.background, said.others) == ("draft_2.nii.gz", 1.5, True, "ignore")
        talker.ask(do="undo")
        talker.hear("opened")
        talker.ask(do="end")
        np.testing.assert_array_equal(talker.labels, wanted.labels)
    with studio(path) as browser, page(browser) as talker:
        np.testing.assert_array_equal(talker.labels, wanted.labels)
        assert (talker.opened["undo_count"], talker.opened["redo_count"]) == (2, 1)
        talker.ask(do="undo")
        talker.hear("opened")
        talker.ask(do="end")
        np.testing.assert_array_equal(talker.labels, before)
        talker.ask(do="redo")
        talker.hear("opened")
        talker.ask(do="end")
        np.testing.assert_array_equal(talker.labels, wanted.labels)
        talker.ask(do="undo")
        talker.ask(do="undo")
        assert path.read_bytes() == text


def test_a_label_outside_the_region_of_interest_is_left_out_of_a_draft_as_in_a_build(recipe):
    path, _ = recipe
    scan = SimpleITK.ReadImage(str(path.parent / "scan.nii.gz"))
    # the outer half along k, with the stroke of background
    centre = list(scan.TransformContinuousIndexToPhysicalPoint((5.5, 4.5, 1.5)))
    path.write_text(path.read_text() + f"\n[region]\ncenter_mm = {centre}\nsize_mm = [12.0, 15.0, 10.0]\n")
    values = np.zeros(scan.GetSize()[::-1], np.uint8)
    values[1:3, 2:6, 2:6] = 1
    values[6:8, 5:9, 6:11] = 5
    with studio(path) as browser, page(browser) as talker:
        assert talker.labels.shape == (4, 10, 12)
        assert send(browser, packed([("x.nii.gz", volume(path, values=values)[0])])).json() == {"problems": []}
        talker.hear("opened")
        talker.ask(do="end")
        assert set(np.unique(talker.labels)) == {0, 1}
        # what lies outside the scan itself, or marks nothing, is refused as before
        assert "marks nothing" in send(browser, packed([("x.nii.gz", volume(path, values=values * 0)[0])])).text


def cube(low, high):
    """A closed box as a text STL, LPS mm."""
    corners = np.array([[(low, high)[n >> a & 1][a] for a in range(3)] for n in range(8)], float)
    faces = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    lines = ["solid SPACE=LPS"]
    for a, b, c, d in faces:
        for corner in ((a, b, c), (a, c, d)):
            lines += ["facet normal 0 0 0", "outer loop"]
            lines += [f"vertex {' '.join(str(x) for x in corners[n])}" for n in corner]
            lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid"]).encode()


def test_parts_are_called_by_their_labels(recipe):
    path, middle = recipe
    body = cube(np.array(middle) - 2.6, np.array(middle) + 2.6)
    with studio(path) as browser, page(browser) as talker:
        refused = send(browser, packed([("Surname.stl", body)]))
        assert refused.json()["problems"] == [
            {"place": "draft", "message": "part 1 is named like no label: name the files like structures"}
        ]
        taken = send(browser, packed([("LEFT_VENTRICLE.stl", body), ("x.stl", body)], ignores_others=True))
        assert taken.json() == {"problems": []}
        talker.hear("opened")
        talker.ask(do="end")
        assert names(path.parent / "draft_1") == ["morphologically left ventricle.stl"]
        session = open_session(path, out=path.parent / "out").session
        assert (session.marked == session.table["left ventricle"].value).sum() > 5
        np.testing.assert_array_equal(talker.labels, session.labels)


def test_what_cannot_be_taken_is_refused_says_why_and_leaves_nothing(recipe, monkeypatch):
    path, _ = recipe
    data, values = volume(path)
    unknown, _ = volume(path, values=np.where(values > 0, np.uint8(99), values))
    text = path.read_bytes()
    with studio(path) as browser, page(browser) as talker:
        first, there = talker.labels.copy(), names(path.parent)
        whole = packed([("a.nii.gz", data)])
        for body, says in (
            (packed([("a.txt", b"hello")]), "this kind of file is not taken"),
            (packed([("a.npz", b"PK")]), "this kind of file is not taken"),
            (packed([("a.nii.gz", data), ("b.nii.gz", data)]), "drop one file"),
            (packed([("a.nii.gz", b"no such thing" * 20)]), ""),
            (packed([("a.nii.gz", unknown)]), "99"),
            (packed([("a.nii.gz", data)], path="../x"), "unknown setting"),
            (packed([("a.nii.gz", data)], core_mm=-1), ""),
            (whole[:-1], "less was sent"),
            (whole + b"x", "more was sent"),
            (b"\xff\xff\xff\xff", "the header is too long"),
            (b"\x02\x00\x00\x00{]", "not valid JSON"),
            (b"", "less was sent"),
            (packed([]), ""),
        ):
            refused = send(browser, body)
            assert refused.status_code == 200
            assert refused.json()["problems"]
            messages = [problem["message"] for problem in refused.json()["problems"]]
            assert any(says in message for message in messages), (says, messages)
            assert "elsewhere" not in str(messages)
            assert str(path.parent) not in str(messages)
        monkeypatch.setattr(drafts, "DRAFT_SIZE_MAX", 1000)
        too_large = send(browser, packed([("a.nii.gz", bytes(1001))]))
        assert "at most" in too_large.json()["problems"][0]["message"]
        # not from another site, nor without its origin, nor for what is not open
        assert send(browser, whole, origin="http://example.org").status_code == 403
        assert browser.post(f"/draft/{browser.opened.key}", content=whole).status_code == 404
        assert browser.post("/draft/another", content=whole, headers={"origin": ADDRESS}).status_code == 404
        assert browser.get(f"/draft/{browser.opened.key}", headers={"origin": ADDRESS}).status_code == 405
        browser.cookies.clear()
        assert send(browser, whole).status_code == 403
        talker.ask(do="end")
        np.testing.assert_array_equal(talker.labels, first)
        assert names(path.parent) == there
    assert path.read_bytes() == text


def claiming(ending, size):
    """A few kilobytes that claim so many zeros along each axis."""
    if ending == ".nrrd":
        header = f"NRRD0004\ntype: uchar\ndimension: 3\nsizes: {size} {size} {size}\nencoding: gzip\n"
        header += "space: left-posterior-superior\nspace directions: (1,0,0) (0,1,0) (0,0,1)\nspace origin: (0,0,0)\n\n"
        return header.encode() + gzip.compress(bytes(1000))
    if ending == ".mha":
        header = (
            f"ObjectType = Image\nNDims = 3\nBinaryData = True\nCompressedData = True\nDimSize = {size} {size} {size}\n"
        )
        header += "ElementSpacing = 1 1 1\nElementType = MET_UCHAR\nElementDataFile = LOCAL\n"
        return header.encode() + zlib.compress(bytes(1000))
    header = bytearray(352)
    struct.pack_into("<i", header, 0, 348)
    struct.pack_into("<8h", header, 40, 3, size, size, size, 1, 1, 1, 1)
    struct.pack_into("<2h", header, 70, 2, 8)
    struct.pack_into("<8f", header, 76, 1, 1, 1, 1, 1, 1, 1, 1)
    struct.pack_into("<f", header, 108, 352)
    header[344:348] = b"n+1\0"
    return gzip.compress(bytes(header) + bytes(1000))


@pytest.mark.parametrize("ending", [".nrrd", ".seg.nrrd", ".nii.gz", ".mha"])
def test_a_small_file_that_claims_a_huge_volume_is_refused_before_it_is_read(recipe, ending):
    path, _ = recipe
    with studio(path) as browser, page(browser):
        kind = ".nrrd" if ending == ".seg.nrrd" else ending
        (problem,) = send(browser, packed([(f"a{ending}", claiming(kind, 600))])).json()["problems"]
        assert "claims more values than 8 times the scan's voxels" in problem["message"]
        # one that may be as large is read, and is found to be cut short
        (problem,) = send(browser, packed([(f"a{ending}", claiming(kind, 300))])).json()["problems"]
        assert "cut short or damaged" in problem["message"]


def test_a_stream_that_goes_on_after_its_values_is_not_inflated_to_its_end(tmp_path):
    file = tmp_path / "long.nrrd"
    header = claiming(".nrrd", 10).partition(b"\n\n")[0] + b"\n\n"
    file.write_bytes(header + gzip.compress(bytes(2000)))
    assert read_labels(file).values.shape == (10, 10, 10)
    file.write_bytes(header + gzip.compress(bytes(1 << 27)) + b"never looked at")
    with pytest.raises(MarkerError, match="damaged"):
        read_labels(file)


def test_a_scan_may_be_drafted_on_a_grid_twice_as_fine():
    assert drafts.value_count_max(Geometry(size=(512, 512, 400))) == 8 * 512 * 512 * 400
    assert drafts.value_count_max(Geometry(size=(10, 10, 10))) == 1 << 26


def test_others_go_on_while_a_draft_is_read(recipe, monkeypatch):
    path, middle = recipe
    data, _ = volume(path)
    begun, goes_on = threading.Event(), threading.Event()
    read = drafts.load_markers

    def slowly(*given, **more):
        begun.set()
        assert goes_on.wait(60)
        return read(*given, **more)

    monkeypatch.setattr(drafts, "load_markers", slowly)
    with studio(path) as browser, page(browser) as talker, ThreadPoolExecutor(1) as pool:
        answer = pool.submit(send, browser, packed([("a.nii.gz", data)]))
        assert begun.wait(60)
        talker.ask(do="paint", label="aorta", radius_mm=1.0, points_mm=[middle])
        assert talker.ask(do="end")["saved"]
        goes_on.set()
        assert answer.result().json() == {"problems": []}
        talker.hear("opened")
        assert [file.path for file in load_recipe(path).markers] == ["draft_1.nii.gz"]
        # labels that are other ones by then may mean something else
        begun.clear()
        goes_on.clear()
        answer = pool.submit(send, browser, packed([("a.nii.gz", data)]))
        assert begun.wait(60)
        there = names(path.parent)
        assert talker.ask(do="add_label", entry={"name": "baffle", "role": "device"})["kind"] == "done"
        goes_on.set()
        assert "was changed while the draft was read" in answer.result().json()["problems"][0]["message"]
        assert len(load_recipe(path).markers) == 1
        assert not [one for one in names(path.parent) if one.startswith(".heartcase-draft")]
        assert len(there) == len(names(path.parent)) + 1


def test_a_draft_for_a_recipe_that_another_program_changed_is_refused_and_the_recipe_opened_again(recipe):
    path, _ = recipe
    data, _ = volume(path)
    with studio(path) as browser, page(browser) as talker:
        path.write_text(path.read_text() + "# by hand\n")
        there = names(path.parent)
        refused = send(browser, packed([("a.nii.gz", data)]))
        assert "another program changed" in refused.json()["problems"][0]["message"]
        assert names(path.parent) == there
        assert path.read_text().endswith("# by hand\n")
        talker.hear("opened")
        assert send(browser, packed([("a.nii.gz", data)])).json() == {"problems": []}
        assert "# by hand\n" in path.read_text()


def test_a_name_that_leads_elsewhere_is_not_written_over(recipe):
    path, _ = recipe
    data, _ = volume(path)
    target = path.parent.parent / "target.bin"
    target.write_bytes(b"kept")
    (path.parent / "draft_1.nii.gz").symlink_to(target)
    with studio(path) as browser, page(browser):
        assert send(browser, packed([("../../draft_9.nii.gz", data)])).json() == {"problems": []}
    assert target.read_bytes() == b"kept"
    assert load_recipe(path).markers[0].path == "draft_2.nii.gz"
