"""Smoothing and filling against shapes whose answer is known."""

from dataclasses import replace

import numpy as np
import pytest

from heartcase.pipeline.artifacts.serialise import artifact_to_bytes
from heartcase.pipeline.data import Segmentation, Structures
from heartcase.pipeline.edits.apply_edits import apply_edits
from heartcase.pipeline.fields.reader import ownership_at_points
from heartcase.pipeline.walls.grow_walls import grow_walls, structure_volumes_ml
from heartcase.schemas.errors import StageError
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.recipe.edit_settings import Fill, Sculpt, SeptalDefect, Smooth
from heartcase.schemas.recipe.settings import WallsSettings
from tests.pipeline.lattices import directions, lattice, points_of

FAR = 100.0


def structures_of(fields, geometry, *, roles=(Role.BLOOD, Role.MYOCARDIUM), wall_mm=0.0, band_mm=8.0) -> Structures:
    """Structures of exact fields; the background is what is left."""
    names = ("cavity", "muscle")
    labels = [
        Label(value=n + 1, name=names[n], role=roles[n], wall_thickness_mm=wall_mm if roles[n] is Role.BLOOD else 0.0)
        for n in range(len(fields))
    ]
    stored = {n + 1: field.astype(np.float32) for n, field in enumerate(fields)}
    stored[0] = (-np.minimum.reduce(list(fields))).astype(np.float32)
    table = LabelTable(labels=tuple(labels)).with_walls()
    return Structures(dict(sorted(stored.items())), geometry, table, band_mm)


def radii(structures, label_void, count=2000, *, low=1.0, high=30.0, centre=(0.0, 0.0, 0.0), seed=3):
    """Distance along rays from the centre at which the owner stops being a void label, shape (count,)."""
    units = directions(count, seed=seed)
    near, far = np.full(count, low), np.full(count, high)
    for _ in range(30):
        middle = 0.5 * (near + far)
        owner = owners(structures, np.array(centre) + middle[:, None] * units)
        inside = owner == label_void
        near, far = np.where(inside, middle, near), np.where(inside, far, middle)
    return near, units


def owners(structures, points):
    owner = ownership_at_points(structures, np.asarray(points).reshape(-1, 3))
    labels = np.where(owner.tissue_mm < 0.0, owner.tissue_label, owner.void_label)
    return labels.reshape(np.asarray(points).shape[:-1])


def divides_space(structures, count=20_000, half=18.0, seed=5):
    """Largest sum of the two lowest fields near a face, mm: above zero a gap, below an overlap."""
    index = structures.geometry.world_to_index(np.random.default_rng(seed).uniform(-half, half, (count, 3)))
    i, j, k = np.rint(index).astype(int).T
    values = np.sort(np.stack([field[k, j, i] for field in structures.distance_mm.values()]), axis=0)
    near = np.abs(values[0]) < 1.0
    return np.abs(values[0] + values[1])[near].max()


def bumpy(geometry, *, radius=14.0, height=0.8, waves=10):
    """A ball with bumps ``height`` high around its equator's direction."""
    points = points_of(geometry)
    r = np.linalg.norm(points, axis=-1)
    polar = np.arctan2(np.hypot(points[..., 0], points[..., 1]), points[..., 2])
    azimuth = np.arctan2(points[..., 1], points[..., 0])
    wave = np.sin(polar) ** 4 * np.cos(waves * azimuth) * np.cos(waves * (polar - 0.5 * np.pi))
    slope = 1.0 + (height * waves / radius) ** 2 * 0.25
    return (r - radius - height * wave) / np.sqrt(slope)


@pytest.mark.parametrize("kind", ["even", "oblique"])
def test_smoothing_takes_the_bumps_and_keeps_the_volume(kind):
    geometry = lattice(kind, 46.0)
    before = structures_of([bumpy(geometry)], geometry)
    edit = Smooth(kind="smooth", label="cavity", points_mm=((0.0, 0.0, 0.0),), radius_mm=40.0, sigma_mm=2.5)
    after = apply_edits(before, (edit,))
    rough, units = radii(before, 1)
    flat, _ = radii(after, 1)
    belt = np.abs(units[:, 2]) < 0.5
    # The waves are 2 pi 14 / 10 = 8.8 mm long along the equator and across it: 1 - (1 - exp(-2 (pi s)^2 2 / l^2))^2.
    kept = 1.0 - (1.0 - np.exp(-4.0 * (np.pi * 2.5 / 8.8) ** 2)) ** 2
    assert rough[belt].std() > 0.2
    assert flat[belt].std() / rough[belt].std() == pytest.approx(kept, abs=0.08)
    assert flat.mean() == pytest.approx(rough.mean(), abs=0.04)
    volumes = structure_volumes_ml(after)[1], structure_volumes_ml(before)[1]
    assert volumes[0] == pytest.approx(volumes[1], rel=0.01)


def test_a_ball_keeps_its_radius():
    geometry = lattice("flat", 40.0)
    ball = np.linalg.norm(points_of(geometry), axis=-1) - 10.0
    before = structures_of([ball], geometry)
    edit = Smooth(kind="smooth", label="cavity", points_mm=((0.0, 0.0, 0.0),), radius_mm=40.0, sigma_mm=2.0)
    # One blur alone would take sigma^2 / R = 0.4 mm.
    was, now = (radii(one, 1)[0] for one in (before, apply_edits(before, (edit,))))
    assert np.abs(now - was).max() < 0.12
    assert now.mean() == pytest.approx(was.mean(), abs=0.05)


def test_nothing_changes_beyond_the_brush_and_the_band():
    geometry = lattice("even", 46.0)
    before = structures_of([bumpy(geometry)], geometry, wall_mm=1.5, band_mm=6.0)
    bytes_before = artifact_to_bytes(before)
    at = (14.0, 0.0, 0.0)
    edit = Smooth(kind="smooth", label="cavity", points_mm=(at,), radius_mm=6.0, sigma_mm=2.0)
    after = apply_edits(before, (edit,))
    assert artifact_to_bytes(before) == bytes_before
    away = np.linalg.norm(points_of(geometry) - np.array(at), axis=-1)
    for value, field in before.distance_mm.items():
        same = after.distance_mm[value] == field
        assert same[away > 6.0 + 6.0].all()
        assert not same[away < 3.0].all()
    assert divides_space(after) < 0.25
    # The border itself stays where the brush does not reach.
    was, units = radii(before, 1)
    now, _ = radii(after, 1)
    outside = np.linalg.norm(was[:, None] * units - np.array(at), axis=1) > 6.0 + 1.75
    assert np.abs(now - was)[outside].max() < 0.02
    assert np.abs(now - was).max() > 0.2


def test_the_wall_follows_what_is_smoothed():
    geometry = lattice("even", 46.0)
    before = structures_of([bumpy(geometry)], geometry, wall_mm=1.5)
    edit = Smooth(kind="smooth", label="cavity", points_mm=((0.0, 0.0, 0.0),), radius_mm=40.0, sigma_mm=3.0)
    after = apply_edits(before, (edit,))
    inner, units = radii(after, 1)
    points = (inner + 0.75)[:, None] * units
    assert (owners(after, points) == after.table.wall_value(1)).all()
    assert (owners(after, (inner + 2.2)[:, None] * units) == 0).all()


def slab(geometry, *, half=4.0, hole=None):
    """A plate of muscle across z, with a round hole along z."""
    points = points_of(geometry)
    plate = np.abs(points[..., 2]) - half
    if hole is None:
        return plate
    across = np.hypot(points[..., 0], points[..., 1])
    inside = np.maximum(plate, hole - across)
    # Outside, the nearest point of a corner of the rim or of the hole's side.
    over = np.hypot(np.maximum(plate, 0.0), np.maximum(hole - across, 0.0))
    return np.where(inside > 0.0, over, inside)


@pytest.mark.parametrize("kind", ["even", "oblique"])
def test_a_hole_is_filled_as_far_as_the_ball_cannot_reach(kind):
    """A ball of radius s that rests on a hole's rim of radius a dips s - sqrt(s^2 - a^2) into it."""
    geometry = lattice(kind, 40.0)
    before = structures_of([np.full(geometry.shape, FAR), slab(geometry, half=6.0, hole=2.5)], geometry)
    edit = Fill(kind="fill", label="muscle", points_mm=((0.0, 0.0, 0.0),), radius_mm=9.0, gap_mm=8.0)
    line = np.linspace(-9.0, 9.0, 1801)[:, None] * [0.0, 0.0, 1.0]
    assert (owners(before, line) == 0).all()
    after = apply_edits(before, (edit,))
    dip = 4.0 - np.sqrt(4.0**2 - 2.5**2)
    filled = (owners(after, line) == 2).sum() * 0.01
    assert filled == pytest.approx(2.0 * (6.0 - dip), abs=0.5)
    assert divides_space(after, half=12.0) < 0.5
    # A hole that is a voxel wider than the ball stays.
    with pytest.raises(StageError, match="no hole or notch of 'muscle' narrower than 3 mm"):
        apply_edits(before, (edit.model_copy(update={"gap_mm": 3.0}),))


def test_a_closed_hollow_is_filled_with_what_is_around_it():
    geometry = lattice("even", 40.0)
    hollow = np.linalg.norm(points_of(geometry), axis=-1) - 2.5
    muscle = np.maximum(np.linalg.norm(points_of(geometry), axis=-1) - 12.0, -hollow)
    before = structures_of([hollow, muscle], geometry)
    base = structure_volumes_ml(before)
    edit = Fill(kind="fill", label="muscle", points_mm=((0.0, 0.0, 0.0),), radius_mm=5.0)
    after = structure_volumes_ml(apply_edits(before, (edit,)))
    assert 1 not in after
    assert after[2] - base[2] == pytest.approx(base[1], abs=0.003)


def test_filling_stays_within_the_brush():
    geometry = lattice("even", 40.0)
    before = structures_of([np.full(geometry.shape, FAR), slab(geometry, half=6.0, hole=2.5)], geometry)
    edit = Fill(kind="fill", label="muscle", points_mm=((0.0, 0.0, 6.0),), radius_mm=6.0, gap_mm=12.0)
    after = apply_edits(before, (edit,))
    line = np.linspace(-9.0, 9.0, 1801)
    found = owners(after, line[:, None] * [0.0, 0.0, 1.0]) == 2
    assert found[(line > 0.5) & (line < 4.5)].all()
    assert not found[line < -0.3].any()


def test_order_with_edits_that_are_laid_over():
    geometry = lattice("even", 46.0)
    before = structures_of([bumpy(geometry)], geometry)
    smooth = Smooth(kind="smooth", label="cavity", points_mm=((14.0, 0.0, 0.0),), radius_mm=6.0)
    add = Sculpt(kind="add", label="cavity", points_mm=((17.0, 0.0, 0.0),), radius_mm=3.0)
    far = add.model_copy(update={"points_mm": ((-17.0, 0.0, 0.0),)})
    with pytest.raises(StageError, match=r"meets an earlier edit of 'cavity' at \(17.0, 0.0, 0.0\) mm") as error:
        apply_edits(before, (far, add, smooth))
    assert [problem.place for problem in error.value.problems] == ["edits[3]"]
    one = apply_edits(before, (smooth, far, add))
    other = apply_edits(before, (far, smooth, add))
    assert one.reshapings == other.reshapings
    assert all((one.distance_mm[value] == other.distance_mm[value]).all() for value in one.distance_mm)


def test_a_smoothing_that_tears_a_structure_says_so():
    geometry = lattice("even", 40.0)
    plate = slab(geometry, half=1.0)
    points = points_of(geometry)
    stick = np.maximum(np.hypot(points[..., 0], points[..., 1]) - 2.0, np.abs(points[..., 2]) - 14.0)
    before = structures_of([np.full(geometry.shape, FAR), stick], geometry)
    edit = Smooth(kind="smooth", label="muscle", points_mm=((0.0, 0.0, 0.0),), radius_mm=8.0, sigma_mm=6.0)
    after = apply_edits(before, (edit,))
    assert [warning.text for warning in after.warnings] == [
        "edits[1]: 'muscle' is in 2 pieces there, 1 before; take a smaller sigma_mm"
    ]
    thin = structures_of(
        [np.full(geometry.shape, FAR), np.maximum(plate, np.linalg.norm(points, axis=-1) - 6.0)], geometry
    )
    whole = edit.model_copy(update={"radius_mm": 40.0})
    assert "nothing of 'muscle' is left there" in apply_edits(thin, (whole,)).warnings[0].text


def test_what_cannot_be_brushed_is_refused():
    geometry = lattice("even", 46.0)
    labels = np.where(bumpy(geometry) < 0.0, 1, 0).astype(np.uint8)
    table = LabelTable(
        labels=(
            Label(value=1, name="aorta", role=Role.VESSEL_LUMEN, wall_thickness_mm=2.0),
            Label(value=2, name="muscle", role=Role.MYOCARDIUM),
        )
    )
    grown = grow_walls(Segmentation(labels, geometry, table), WallsSettings(), ())
    edits = [
        Smooth(kind="smooth", label=label, points_mm=(at,), radius_mm=4.0)
        for label, at in (
            ("aorta wall", (15.0, 0.0, 0.0)),
            ("muscle", (0.0, 0.0, 0.0)),
            ("valve", (0.0, 0.0, 0.0)),
            ("aorta", (20.0, 0.0, 0.0)),
            ("aorta", (200.0, 0.0, 0.0)),
        )
    ]
    with pytest.raises(StageError) as error:
        apply_edits(grown, edits)
    words = ("follows it: name 'aorta'", "nothing of 'muscle'", "no label 'valve'", "touches no 'aorta'", "outside the")
    assert len(error.value.problems) == len(words)
    for problem, part in zip(error.value.problems, words, strict=True):
        assert part in problem.message


def test_switched_off_edits_change_nothing():
    geometry = lattice("even", 46.0)
    before = structures_of([bumpy(geometry)], geometry)
    smooth = Smooth(kind="smooth", label="cavity", points_mm=((14.0, 0.0, 0.0),), radius_mm=6.0)
    off = replace(before)
    nowhere = SeptalDefect(kind="septal_defect", position_mm=(500, 0, 0), diameter_mm=3, axis=(1, 0, 0), enabled=False)
    assert apply_edits(off, (nowhere, smooth.model_copy(update={"enabled": False}))) is off
    with pytest.raises(StageError) as error:
        apply_edits(before, (nowhere, nowhere.model_copy(update={"enabled": True})))
    assert error.value.problems[0].place == "edits[2]"
