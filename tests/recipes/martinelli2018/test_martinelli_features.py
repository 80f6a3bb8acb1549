from __future__ import annotations

import warnings
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdr_filter.recipes.martinelli2018.features import (
    NAMES,
    WITHOUT_GYROSCOPE,
    WITHOUT_MAGNETOMETER,
    features_28,
)

RATE_HZ = 100.0


def literal_features(window: np.ndarray, rate_hz: float) -> list[float]:
    """Table II, feature after feature, as a reader of the paper would write it."""
    a, a_f, g, m = window
    found: list[float] = []
    found += [x.max() - x.min() for x in (a, a_f, g, m)]  # F1-F4
    means = (a.mean(), a.mean(), g.mean(), m.mean())  # F6, F10 and F14 have the mean of a, not that of LPF(a)
    stds = [np.sqrt(((x - mean) ** 2).sum() / len(x)) for x, mean in zip((a, a_f, g, m), means, strict=True)]
    found += stds  # F5-F8
    for power in (3, 4):  # F9-F16
        for x, mean, std in zip((a, a_f, g, m), means, stds, strict=True):
            found.append(((x - mean) ** power).sum() / len(x) / std**power)
    found += [sum(v**2 for v in x) for x in (a, a_f, g, m)]  # F17-F20
    spectra = [np.abs(np.fft.fft(x - x.mean()))[: len(x) // 2 + 1] for x in (a, a_f, g)]
    found += [s.max() for s in spectra]  # F21-F23
    found += [int(np.argmax(s)) * rate_hz / len(a) for s in spectra]  # F24-F26
    for x in (a, a_f):  # F27-F28
        signs = [v - x.mean() < 0 for v in x]
        found.append(sum(p != q for p, q in pairwise(signs)) / (len(x) - 1))
    return found


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), n=st.sampled_from([100, 199, 200, 256]), scale=st.floats(0.01, 100))
def test_every_feature_equals_its_literal_formula(seed: int, n: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    window = np.abs(scale * (rng.gamma(2.0, size=(4, n)) + rng.uniform(0, 10, (4, 1))))
    expected = literal_features(window, RATE_HZ)
    for name, value, literal in zip(NAMES, features_28(window, RATE_HZ), expected, strict=True):
        assert value == pytest.approx(literal, rel=1e-9, abs=1e-12), name


def test_there_are_28_distinct_names_in_the_order_of_the_paper() -> None:
    assert len(set(NAMES)) == len(NAMES) == 28
    assert (NAMES[0], NAMES[13], NAMES[20], NAMES[27]) == (
        "range_acc",
        "kurtosis_acc_f",
        "peak_acc",
        "zero_crossing_rate_acc_f",
    )


def test_reduced_sets_leave_out_exactly_the_missing_sensor() -> None:
    window = np.random.default_rng(0).gamma(2.0, size=(4, 200))
    other = window.copy()
    other[3] = 0.0
    changed = features_28(window, RATE_HZ) != features_28(other, RATE_HZ)
    assert {n for n, c in zip(NAMES, changed, strict=True) if c} == set(NAMES) - set(WITHOUT_MAGNETOMETER)
    other[2] = 0.0
    changed = features_28(window, RATE_HZ) != features_28(other, RATE_HZ)
    assert {n for n, c in zip(NAMES, changed, strict=True) if c} == set(NAMES) - set(WITHOUT_GYROSCOPE)


@pytest.mark.parametrize("level", [0.0, 9.80665, 50.0, 1e-3])
def test_a_constant_window_gives_zero_moments_and_no_warning(level: float) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        features = dict(zip(NAMES, features_28(np.full((4, 200), level), RATE_HZ), strict=True))
    assert features["energy_acc"] == pytest.approx(200 * level**2)
    for name, value in features.items():
        if name.startswith(("range", "std", "skewness", "kurtosis", "peak_acc", "peak_gyro")):
            assert value == pytest.approx(0.0, abs=1e-9), name


def test_frequencies_follow_the_sampling_rate() -> None:
    window = np.random.default_rng(1).gamma(2.0, size=(4, 200))
    slow, fast = features_28(window, 50.0), features_28(window, 100.0)
    hertz = [n.endswith("_hz") for n in NAMES]
    np.testing.assert_allclose(fast[hertz], 2 * slow[hertz])
    np.testing.assert_array_equal(fast[~np.array(hertz)], slow[~np.array(hertz)])
