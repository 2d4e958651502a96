"""A locked recipe knows its marker files and its finished segmentation again, and no others."""

import os

import numpy as np
import pytest
import SimpleITK
import trimesh

from heartcase.cli.main import main
from heartcase.pipeline.building.lock import changed_files, check_lock, lock_recipe, recipe_text
from heartcase.pipeline.data import Scan
from heartcase.pipeline.formats.write_images import write_scan
from heartcase.pipeline.markers.load_markers import load_segmentation
from heartcase.pipeline.stages.read import region_of_scan
from heartcase.schemas.errors import MarkerError, RecipeError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.recipe import load_recipe, parse_recipe
from tests.pipeline.building.test_lock import relocked

SMALL = Geometry.of(shape=(8, 9, 10), spacing_mm=(2, 2, 2), origin_mm=(-9, -8, -7))
SMALL_RECIPE = """
heartcase_recipe = 1
name = "small"
scan = {{ path = "scan.nii.gz" }}
segment = {{ {segment} }}
markers = [{markers}]
"""


def small(directory, *, segment="", markers=()):
    """A recipe for a scan of 720 voxels, with this segmentation or these marker files."""
    values = np.arange(720, dtype=np.float32).reshape(SMALL.shape)
    write_scan(Scan(values, SMALL, "MR"), directory / "scan.nii.gz")
    files = ", ".join(f'{{ path = "{name}" }}' for name in markers)
    finished = f'method = "labels", file = "{segment}"' if segment else ""
    path = directory / "small.toml"
    path.write_text(SMALL_RECIPE.format(segment=finished, markers=files))
    return load_recipe(path)


def write_volume(path, value=1):
    """A box of one label; what is written is called as SimpleITK likes, then as the test wants."""
    labels = np.zeros(SMALL.shape, np.uint8)
    labels[2:5, 3:6, 2:8] = value
    image = SimpleITK.GetImageFromArray(labels)
    image.SetSpacing(SMALL.spacing_mm)
    image.SetOrigin(SMALL.origin_mm)
    written = path.with_suffix({".nrrd": ".nhdr", ".mha": ".mhd"}.get(path.suffix, path.suffix))
    SimpleITK.WriteImage(image, str(written))
    if path.suffix == ".nrrd":
        # in a .nrrd file an empty line ends the header
        written.write_bytes(written.read_bytes() + b"\n")
    written.replace(path)


def write_inline(path, value=1):
    write_volume(path.with_suffix(".nhdr"), value)
    SimpleITK.WriteImage(SimpleITK.ReadImage(str(path.with_suffix(".nhdr"))), str(path), True)


def write_parts(folder, value=1):
    """Two balls of different size as LV and RV; the other way round for another value than 1."""
    folder.mkdir(exist_ok=True)
    for name, radius, x in zip(("LV", "RV")[:: 1 if value == 1 else -1], (3.0, 2.0), (-5.0, 3.0), strict=True):
        ball = trimesh.creation.icosphere(subdivisions=1, radius=radius)
        ball.apply_translation((x, 0, 0))
        (folder / f"{name}.stl").write_bytes(ball.export(file_type="stl"))


FINISHED = {
    "JANE-DOE.nii.gz": write_volume,
    "JANE-DOE.seg.nrrd": write_inline,
    "JANE-DOE.nhdr": write_volume,
    "JANE-DOE.nrrd": write_volume,
    "JANE-DOE.mhd": write_volume,
    "JANE-DOE.mha": write_volume,
    "JANE-DOE": write_parts,
}
"""Ways to give a finished segmentation; .nhdr, .nrrd, .mhd and .mha are headers of a data file of its own."""


def taken(path):
    """The labels that a build would take."""
    return load_segmentation(path, {}, load_recipe(path.parent / "small.toml").table, SMALL).labels


@pytest.mark.parametrize("name", FINISHED)
def test_another_segmentation_is_refused(tmp_path, name):
    path = tmp_path / name
    FINISHED[name](path)
    text = recipe_text(lock_recipe(small(tmp_path, segment=name), directory=tmp_path, out=tmp_path))
    locked = parse_recipe(text)
    assert check_lock(locked, tmp_path, region_of_scan(locked, tmp_path)) == ()
    before, header = taken(path), b"" if path.is_dir() else path.read_bytes()
    FINISHED[name](path, 2)
    assert (taken(path) != before).any()
    if name.endswith((".nhdr", ".nrrd", ".mhd", ".mha")) and ".seg" not in name:
        # the values are elsewhere: the header says nothing of the change
        assert path.read_bytes() == header
    with pytest.raises(RecipeError) as error:
        check_lock(locked, tmp_path, region_of_scan(locked, tmp_path))
    (problem,) = error.value.problems
    assert problem.place == "segment.file"
    assert problem.message.startswith("the segmentation is not the one that the recipe was locked with: put back")
    assert "JANE" not in str(error.value)
    (warning,) = check_lock(locked, tmp_path, region_of_scan(locked, tmp_path), accept_inputs=True)
    assert "segment.file: the segmentation is not the one" in warning.text
    FINISHED[name](path)
    assert (taken(path) == before).all()
    assert list(changed_files(locked, tmp_path)) == []


def test_a_file_that_is_not_read_is_no_change_of_the_parts(tmp_path):
    write_parts(tmp_path / "parts")
    locked = lock_recipe(small(tmp_path, segment="parts"), directory=tmp_path, out=tmp_path)
    (tmp_path / "parts" / "notes.txt").write_text("seen")
    assert list(changed_files(locked, tmp_path)) == []
    (tmp_path / "parts" / "RV.stl").unlink()
    assert [problem.place for problem in changed_files(locked, tmp_path)] == ["segment.file"]


def test_the_file_of_a_dicom_folder_may_have_another_name_but_not_another_content(tmp_path):
    folder = tmp_path / "seg"
    folder.mkdir()
    (folder / "IM0001").write_bytes(b"one")
    locked = lock_recipe(small(tmp_path, segment="seg"), directory=tmp_path, out=tmp_path)
    (folder / "IM0001").rename(folder / "IM0002")
    assert list(changed_files(locked, tmp_path)) == []
    (folder / "IM0002").write_bytes(b"two")
    assert [problem.place for problem in changed_files(locked, tmp_path)] == ["segment.file"]


@pytest.mark.parametrize("name", ["a.nrrd", "a.mha"])
def test_a_lost_data_file_is_a_problem_of_its_header(tmp_path, name):
    write_volume(tmp_path / name)
    recipe = small(tmp_path, segment=name, markers=[name])
    locked = lock_recipe(recipe, directory=tmp_path, out=tmp_path)
    for data in tmp_path.glob("*raw"):
        data.unlink()
    problems = list(changed_files(locked, tmp_path))
    assert [problem.place for problem in problems] == ["markers[1]", "segment.file"]
    assert all("data file" in problem.message for problem in problems)
    with pytest.raises(MarkerError) as error:
        lock_recipe(recipe, directory=tmp_path, out=tmp_path)
    assert [problem.place for problem in error.value.problems] == ["markers[1]"]


def test_a_segmentation_is_found_from_where_the_lock_is(tmp_path):
    write_volume(tmp_path / "labels.nhdr")
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    recipe = small(tmp_path, segment="labels.nhdr")
    locked = lock_recipe(recipe, directory=tmp_path, out=folder)
    assert (folder / locked.segment.file).resolve() == (tmp_path / "labels.nhdr").resolve()
    assert not os.path.isabs(locked.segment.file)
    assert locked.missing_files(folder) == ()
    assert check_lock(locked, folder, region_of_scan(locked, folder)) == ()
    write_volume(tmp_path / "labels.nhdr", 2)
    assert [problem.place for problem in changed_files(locked, folder)] == ["segment.file"]
    whole = str(tmp_path / "labels.nhdr")
    absolute = recipe.model_copy(update={"segment": recipe.segment.model_copy(update={"file": whole})})
    assert lock_recipe(absolute, directory=tmp_path, out=folder).segment.file == whole


def test_a_segmentation_that_was_not_there_at_locking_is_another_one(tmp_path):
    write_volume(tmp_path / "labels.nhdr")
    locked = recipe_text(lock_recipe(small(tmp_path, segment="labels.nhdr"), directory=tmp_path, out=tmp_path))
    before = relocked(locked, lock=lambda table: {k: v for k, v in table.items() if k != "segmentation_sha256"})
    assert [problem.place for problem in changed_files(before, tmp_path)] == ["segment.file"]
    whole = parse_recipe(locked)
    without = whole.model_copy(update={"segment": whole.segment.model_copy(update={"method": "watershed"})})
    assert [problem.place for problem in changed_files(without, tmp_path)] == ["segment.file"]


@pytest.mark.parametrize("change", [lambda files: files[:1], lambda files: [*files, files[0]]])
def test_another_number_of_marker_files_is_refused(tmp_path, change):
    for name in ("one.mrk.json", "two.mrk.json"):
        (tmp_path / name).write_text(f'{{"markups": [], "is": "{name}"}}')
    recipe = small(tmp_path, markers=["one.mrk.json", "two.mrk.json"])
    text = recipe_text(lock_recipe(recipe, directory=tmp_path, out=tmp_path))
    other = relocked(text, markers=change)
    with pytest.raises(RecipeError) as error:
        check_lock(other, tmp_path, region_of_scan(other, tmp_path))
    (problem,) = error.value.problems
    assert problem.place == "markers"
    assert f"there are {len(other.markers)} files, not the 2 at locking" in problem.message
    swapped = relocked(text, markers=lambda files: files[::-1])
    assert [problem.place for problem in changed_files(swapped, tmp_path)] == ["markers[1]", "markers[2]"]


def test_validate_sees_what_changed_since_locking(tmp_path, capsys):
    (tmp_path / "JANE.mrk.json").write_text('{"markups": []}')
    write_volume(tmp_path / "labels.nrrd")
    recipe = small(tmp_path, segment="labels.nrrd", markers=["JANE.mrk.json"])
    lock = tmp_path / "small.lock.toml"
    lock.write_text(recipe_text(lock_recipe(recipe, directory=tmp_path, out=tmp_path)))
    assert main(["validate", str(lock)]) == 0
    (tmp_path / "JANE.mrk.json").write_text('{"markups": [1]}')
    write_volume(tmp_path / "labels.nrrd", 2)
    capsys.readouterr()
    assert main(["validate", str(lock)]) == 1
    said = capsys.readouterr().out
    assert "markers[1]: the file is not the one that the recipe was locked with" in said
    assert "segment.file: the segmentation is not the one that the recipe was locked with" in said
    assert "JANE" not in said
    # the recipe itself is not locked, so nothing is another one
    assert main(["validate", str(tmp_path / "small.toml")]) == 0
