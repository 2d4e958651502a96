"""Reading cases of later versions: unknown majors and extensions are refused, what a newer minor adds is ignored."""

import hashlib
import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.pipeline.bundle.write_bundle import write_bundle
from heartcase.schemas.bundle.check import check_bundle
from heartcase.schemas.bundle.format import FORMAT_VERSION, FileRole
from heartcase.schemas.bundle.reader import open_bundle, read_manifest
from heartcase.schemas.errors import BundleError
from tests.factories import block_case

MAJOR, MINOR = (int(part) for part in FORMAT_VERSION.split("."))
NEWER = f"{MAJOR}.{MINOR + 1}"
FREE = {"settings", "quality", "acquisition"}
"""Keys of the manifest under which anything may stand."""


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    directory = tmp_path_factory.mktemp("forward") / "block.case"
    write_bundle(directory, block_case())
    return directory


@pytest.fixture(scope="module")
def manifest(case):
    return json.loads((case / "case.json").read_text())


def with_manifest(case, data):
    (case / "case.json").write_text(json.dumps(data))
    return case


def tables(node, path=()):
    """Paths of all tables of a manifest whose keys the format fixes."""
    if isinstance(node, dict):
        yield path
        for key, inner in node.items():
            if key not in FREE:
                yield from tables(inner, (*path, key))
    elif isinstance(node, list):
        for number, inner in enumerate(node):
            yield from tables(inner, (*path, number))


def at(node, path):
    for key in path:
        node = node[key]
    return node


json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-9, 9) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(st.text(max_size=5), inner, max_size=2),
)


@given(data=st.data())
@settings(max_examples=60)
def test_unknown_keys_anywhere_of_a_newer_minor_version_are_ignored(case, manifest, data):
    changed = json.loads(json.dumps(manifest))
    places = sorted(tables(changed), key=str)
    assert len(places) > 15
    for place in data.draw(st.lists(st.sampled_from(places), min_size=1, max_size=4)):
        key = data.draw(st.text(min_size=1, max_size=5).map(lambda text: f"new {text}"))
        at(changed, place)[key] = data.draw(json_values)
    with pytest.raises(BundleError, match="unknown setting"):
        read_manifest(with_manifest(case, changed))
    changed["format_version"] = NEWER
    read = open_bundle(with_manifest(case, changed)).manifest
    original = read_manifest(with_manifest(case, manifest))
    assert read.model_copy(update={"format_version": original.format_version}) == original


def test_a_file_with_a_role_of_a_newer_minor_version_is_ignored(case, manifest):
    extra = {"role": "flow", "name": "flow-0.vtk", "size": 4, "sha256": "0" * 64, "codec": "x"}
    changed = manifest | {"format_version": NEWER, "files": [extra, *manifest["files"]]}
    bundle = open_bundle(with_manifest(case, changed))
    assert {entry.role for entry in bundle.manifest.files} == {FileRole(one["role"]) for one in manifest["files"]}
    # Validate vouches for all bytes, as an approval does.
    assert [str(problem) for problem in check_bundle(case)] == [
        "files.flow: the file flow-0.vtk is missing: build the case again"
    ]
    (case / "flow-0.vtk").write_bytes(b"flow")
    assert ["was changed" in str(problem) for problem in check_bundle(case)] == [True]
    extra["sha256"] = hashlib.sha256(b"flow").hexdigest()
    assert check_bundle(with_manifest(case, changed)) == ()
    (case / "flow-0.vtk").unlink()
    for version in (FORMAT_VERSION, f"{MAJOR}.0"):
        with pytest.raises(BundleError, match=r"files\[1\].role"):
            open_bundle(with_manifest(case, changed | {"format_version": version}))


def test_an_unknown_role_of_a_label_is_never_guessed(case, manifest):
    # Tissue or void: a simulator cannot ignore the difference.
    changed = json.loads(json.dumps(manifest)) | {"format_version": NEWER}
    changed["labels"]["labels"][2]["role"] = "valve"
    with pytest.raises(BundleError) as error:
        open_bundle(with_manifest(case, changed))
    first, second = error.value.problems
    assert (first.place, second.place) == ("format_version", "case.json.labels.labels[3].role")
    assert f"{NEWER}, newer than {FORMAT_VERSION} of this heartcase: use the version that wrote it" in first.message


def test_arrays_that_a_newer_minor_version_adds_are_ignored(case, manifest, tmp_path):
    import struct

    changed = json.loads(json.dumps(manifest)) | {"format_version": NEWER}
    entry = next(one for one in changed["files"] if one["role"] == "grid")
    old = (case / entry["name"]).read_bytes()
    length = struct.unpack("<Q", old[:8])[0]
    header = json.loads(old[8 : 8 + length])
    end = max(one["data_offsets"][1] for name, one in header.items() if name != "__metadata__")
    header["later"] = {"dtype": "F8_E4M3", "shape": [64], "data_offsets": [end, end + 64]}
    text = json.dumps(header).encode()
    text += b" " * (-(len(text) + 8 - (8 + length)) % 64)
    shift = len(text) - length
    new = struct.pack("<Q", len(text)) + text + old[8 + length :] + bytes(64)
    name = "grid-later.safetensors"
    (case / name).write_bytes(new)
    entry.update(name=name, size=len(new), sha256=hashlib.sha256(new).hexdigest())
    for one in entry.get("arrays", []):
        one["offset"] += shift
    listed = {"name": "later", "dtype": "float8", "shape": [64], "offset": -(-(8 + len(text) + end) // 64) * 64}
    entry.setdefault("arrays", []).append(listed | {"unit": "1", "meaning": "of later", "colour": "red"})
    try:
        bundle = open_bundle(with_manifest(case, changed))
        before = open_bundle(with_manifest(case, manifest)).arrays(FileRole.GRID)
        for key, values in bundle.arrays(FileRole.GRID).items():
            assert (values == before[key]).all()
    finally:
        (case / name).unlink()


@pytest.mark.parametrize(
    "version", [f"{MAJOR + 1}.0", "0.9", f"{MAJOR + 1}.{MINOR + 1}", "10.0", "", "x", None, 1, "1"]
)
def test_an_unknown_major_version_is_refused_whatever_else_is_there(case, manifest, version):
    changed = {"format": manifest["format"], "format_version": version, "later": 1}
    with pytest.raises(BundleError, match=r"format_version"):
        open_bundle(with_manifest(case, changed))
    assert check_bundle(case)


@pytest.mark.parametrize("version", [f"{MAJOR}.x", f"{MAJOR}.", f"{MAJOR}.1.3", f"{MAJOR}.²"])
def test_a_version_that_is_none_is_refused(case, manifest, version):
    with pytest.raises(BundleError, match="format_version"):
        open_bundle(with_manifest(case, manifest | {"format_version": version}))


def test_an_absurdly_late_minor_version_is_a_newer_one(case, manifest):
    late = manifest | {"format_version": f"{MAJOR}.{'9' * 5000}", "later": 1}
    assert open_bundle(with_manifest(case, late)).manifest.name == "block"


@pytest.mark.parametrize("version", [FORMAT_VERSION, NEWER])
def test_a_required_extension_that_is_not_known_is_refused_by_name(case, manifest, version):
    changed = manifest | {"format_version": version, "required_extensions": ["sutures", "flow"], "later": 1}
    with pytest.raises(BundleError) as error:
        open_bundle(with_manifest(case, changed))
    assert [problem.place for problem in error.value.problems] == ["required_extensions"] * 2
    assert "'flow' is not known" in str(error.value)


@pytest.mark.parametrize("files", [None, 7, [7], [None], [{"role": 7}], [{"role": None}], {}, [{"role": ["grid"]}]])
def test_a_list_of_files_that_is_none_is_refused(case, manifest, files):
    with pytest.raises(BundleError, match="files"):
        open_bundle(with_manifest(case, manifest | {"format_version": NEWER, "files": files}))


@pytest.mark.parametrize(
    "wrong", [{"name": "../v"}, {"name": "/v"}, {"name": 7}, {"size": -1}, {"sha256": "0"}, {"name": "a/b"}]
)
def test_a_file_with_a_role_of_a_newer_minor_version_must_be_sound_all_the_same(case, manifest, wrong):
    extra = {"role": "flow", "name": "flow-0.vtk", "size": 4, "sha256": "0" * 64} | wrong
    with pytest.raises(BundleError, match=r"files\[1\]"):
        open_bundle(with_manifest(case, manifest | {"format_version": NEWER, "files": [extra, *manifest["files"]]}))
