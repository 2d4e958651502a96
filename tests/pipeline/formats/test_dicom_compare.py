"""Reconstructions that differ in the kernel alone are told apart by what is measured, and have codes of their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from heartcase.pipeline.formats.dicom.compare import noise_level
from heartcase.pipeline.formats.read_scan import list_series, read_scan
from tests.pipeline.formats.dicom_series import write_series
from tests.pipeline.formats.dicom_situations_doubtful import kernels


@pytest.mark.parametrize("sigma_hu", [8.0, 25.0])
@pytest.mark.parametrize("blur", [0.0, 1.0])
def test_noise_is_that_which_was_added(sigma_hu: float, blur: float) -> None:
    """Soft tissue with a vessel, lung and air; the deviation of smoothed white noise by Parseval's theorem."""
    rng = np.random.default_rng(3)
    j, i = np.indices((160, 160))
    body = np.where((i - 80) ** 2 + (j - 80) ** 2 < 70**2, 50.0, -1000.0)
    body = np.where((i - 60) ** 2 + (j - 80) ** 2 < 25**2, -850.0, body)
    body = np.where((i - 105) ** 2 + (j - 80) ** 2 < 12**2, 350.0, body)
    noise = rng.normal(0.0, sigma_hu, (3, 160, 160))
    impulse = np.zeros((41, 41))
    impulse[20, 20] = 1.0
    if blur:
        noise = np.stack([ndimage.gaussian_filter(plane, blur) for plane in noise])
        impulse = ndimage.gaussian_filter(impulse, blur)
    expected = sigma_hu * np.sqrt((impulse**2).sum())
    found = noise_level((body + noise).astype(np.float32), pixel_mm=0.7, is_ct=True)
    assert found == pytest.approx(expected, rel=0.12)


def test_kernels_are_told_apart_by_what_is_measured(tmp_path: Path) -> None:
    volumes = kernels(tmp_path / "scan")
    smooth, sharp = list_series(tmp_path / "scan")
    assert "smoother, noise " in smooth.description
    assert smooth.description.endswith("suits segmentation better: its edges stand out more from its noise")
    assert "sharper, noise " in sharp.description
    assert "suits" not in sharp.description
    for info, volume in ((smooth, volumes[0]), (sharp, volumes[1])):
        told = float(info.description.partition("noise ")[2].split()[0])
        true = volume[:, 30:50, 50:78].std(ddof=1)
        assert told == pytest.approx(true, rel=0.15)
    assert "Sensitivus" not in repr((smooth, sharp))
    for info, volume in ((smooth, volumes[0]), (sharp, volumes[1])):
        np.testing.assert_array_equal(read_scan(tmp_path / "scan", series=info.uid_code).values, volume)
    assert smooth.uid_code.partition("-")[0] == sharp.uid_code.partition("-")[0]
    assert smooth.uid_code != sharp.uid_code


def test_codes_stay_when_other_series_come_and_files_have_other_names(tmp_path: Path) -> None:
    kernels(tmp_path / "scan")
    before = {info.uid_code for info in list_series(tmp_path / "scan")}
    for number, path in enumerate(sorted((tmp_path / "scan").iterdir(), reverse=True)):
        path.rename(path.with_name(f"x{number:03d}"))
    positions = np.array([[0.0, 0.0, 2.0 * k] for k in range(7)])
    write_series(tmp_path / "scan" / "more", np.zeros((7, 9, 9), np.int16), positions, series=2)
    after = [info.uid_code for info in list_series(tmp_path / "scan")]
    assert len(after) == 3
    assert before < set(after)


def test_three_reconstructions_are_put_in_order(tmp_path: Path) -> None:
    _, sharp = kernels(tmp_path / "scan")
    positions = np.array([[-30.0, -30.0, 3.0 * k] for k in range(5)])
    smoothest = np.round(np.stack([ndimage.gaussian_filter(plane.astype(float), 2.0) for plane in sharp]))
    write_series(tmp_path / "scan", smoothest.astype(np.int16), positions, series=7)
    words = [info.description.split(", ")[3] for info in list_series(tmp_path / "scan")]
    assert words == ["of middle sharpness", "sharpest", "smoothest"]


def test_scans_at_other_places_are_not_compared(tmp_path: Path) -> None:
    volume = np.random.default_rng(0).normal(40.0, 10.0, (5, 32, 32)).astype(np.int16)
    for series in (1, 2):
        positions = np.array([[0.0, 0.0, 3.0 * k + 50.0 * series] for k in range(5)])
        write_series(tmp_path, volume, positions, series=series)
    assert all("noise" not in info.description for info in list_series(tmp_path))
