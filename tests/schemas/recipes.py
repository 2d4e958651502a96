"""Any recipe, for property tests."""

from __future__ import annotations

from hypothesis import strategies as st

from heartcase.schemas.recipe.recipe import Part, Recipe

names = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9 _.()+-]{0,10}", fullmatch=True)
numbers = st.floats(-300, 300)
lengths = st.floats(1e-6, 900)
points = st.tuples(numbers, numbers, numbers)
axes = points.filter(any)
paths = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=10)


def maybe(**fields):
    """Some of these fields: what is left out takes its default."""
    return st.fixed_dictionaries({}, optional=fields)


def _is_to_another(edit):
    """Whether an edit names its own label only once."""
    return edit.get("label") not in {edit.get("into", ""), *edit.get("only_from", ())}


def _edits(label):
    lines = st.lists(points, min_size=1, max_size=3)
    defect = {"position_mm": points, "diameter_mm": lengths, "axis": axes}
    return st.lists(
        st.one_of(
            st.fixed_dictionaries({"kind": st.just("septal_defect"), **defect}, optional={"length_mm": lengths}),
            st.fixed_dictionaries({"kind": st.just("close_defect"), **defect}, optional={"thickness_mm": lengths}),
            st.fixed_dictionaries(
                {"kind": st.just("add"), "label": label, "radius_mm": lengths, "points_mm": lines},
                optional={"only_from": st.lists(label, min_size=1, max_size=2)},
            ).filter(_is_to_another),
            st.fixed_dictionaries(
                {"kind": st.just("remove"), "label": label, "radius_mm": lengths, "points_mm": lines},
                optional={"into": label},
            ).filter(_is_to_another),
            st.fixed_dictionaries(
                {"kind": st.just("smooth"), "label": label, "radius_mm": lengths, "points_mm": lines},
                optional={"sigma_mm": lengths, "enabled": st.booleans()},
            ),
            st.fixed_dictionaries(
                {"kind": st.just("fill"), "label": label, "radius_mm": lengths, "points_mm": lines},
                optional={"gap_mm": lengths, "name": st.just("mend the septum")},
            ),
            st.fixed_dictionaries({"kind": st.just("keep_largest"), "label": label}, optional={"into": label}).filter(
                _is_to_another
            ),
            st.fixed_dictionaries({"kind": st.just("remove_islands")}, optional={"label": label, "into": label}).filter(
                _is_to_another
            ),
        ),
        max_size=3,
    )


def _labels(draw):
    chosen = draw(st.lists(names, min_size=1, max_size=4, unique_by=str.lower))
    chosen = [name for name in chosen if name.lower() != "background"] or ["aorta"]
    values = draw(st.lists(st.integers(1, 200), min_size=len(chosen), max_size=len(chosen), unique=True))
    labels = []
    for name, value in zip(chosen, values, strict=True):
        role = draw(st.sampled_from(["blood", "vessel_lumen", "myocardium", "wall", "device"]))
        more = draw(maybe(colour=st.sampled_from(["#00ff00", "#ABCDEF"]), snomed=st.just("999999999")))
        labels.append({"value": value, "name": name, "role": role, **more})
    return labels


@st.composite
def recipe_data(draw):
    """What the TOML file of a recipe may hold, as its author would write it."""
    labels = _labels(draw)
    label = st.sampled_from([one["name"] for one in labels])
    materials = maybe(youngs_modulus_kpa=st.floats(0.1, 5e3), density_kg_m3=st.floats(500, 3e3))
    stroke = st.fixed_dictionaries(
        {"label": label, "points_mm": st.lists(points, min_size=1, max_size=3)},
        optional={"radius_mm": st.floats(0, 50)},
    )
    marker = st.fixed_dictionaries({"path": paths}, optional={"names": st.dictionaries(paths, label, max_size=2)})
    optional = {
        "region": st.fixed_dictionaries({"center_mm": points, "size_mm": st.tuples(lengths, lengths, lengths)}),
        "filter": maybe(
            method=st.sampled_from(["curvature_diffusion", "gradient_diffusion", "none"]),
            iterations=st.integers(1, 200),
            time_step=lengths,
        ),
        "markers": st.lists(marker, max_size=2),
        "walls": maybe(smoothing_mm=st.floats(0, 20), band_mm=lengths),
        "edits": _edits(label),
        "grid": maybe(cell_mm=lengths, repair=st.booleans()) | maybe(node_count=st.integers(8, 10**6)),
        "surface": maybe(triangle_count=st.integers(100, 10**6), normal_map_size=st.sampled_from([0, 128, 8192])),
        "materials": st.builds(
            lambda base, exceptions: {**base, "labels": exceptions},
            materials,
            st.dictionaries(label, materials, max_size=2),
        ),
        "pins": st.lists(st.fixed_dictionaries({"position_mm": points, "radius_mm": lengths}), max_size=2),
        "ends": st.lists(
            st.fixed_dictionaries({"label": label, "position_mm": points, "axis": axes, "radius_mm": lengths}),
            max_size=2,
        ),
        "parts": st.sampled_from([[], [Part.SURFACE.value], [Part.PICKING.value, Part.LABELS.value]]),
    }
    scan = st.fixed_dictionaries(
        {"path": paths}, optional={"series": paths, "modality": st.sampled_from(["CT", "MR"]), "origin": paths}
    )
    return {
        "heartcase_recipe": 1,
        "name": draw(names),
        "scan": draw(scan),
        "labels": labels,
        "strokes": draw(st.lists(stroke, min_size=1, max_size=2)),
        **draw(st.fixed_dictionaries({}, optional=optional)),
    }


def recipes():
    """Recipes."""
    return recipe_data().map(Recipe.model_validate)
