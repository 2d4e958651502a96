"""Where tours of a case are looked for: beside it, and beside its recipe where that lies above its folder."""

from heartcase.studio.touring.found_tours import tour_folders
from tests.ball import write_ball_recipe


def test_the_recipe_above_the_cases_folder_leads_to_its_tours(tmp_path):
    case = tmp_path / "out" / "ball.case"
    case.mkdir(parents=True)
    assert tour_folders(case, "ball") == [tmp_path / "out"]
    (tmp_path / "broken.toml").write_text('heartcase_recipe = 1\nname = "ball"\nwhat = ')
    (tmp_path / "script.toml").write_text('heartcase_script = 1\nname = "ball"\n')
    assert tour_folders(case, "ball") == [tmp_path / "out"]
    write_ball_recipe(tmp_path / "scan.nii.gz", tmp_path / "any name.toml")
    assert tour_folders(case, "ball") == [tmp_path / "out", tmp_path]
    # of another case's recipe nothing is said of this one
    assert tour_folders(case, "other") == [tmp_path / "out"]
