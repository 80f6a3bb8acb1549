"""Calibration of whole recordings: use of the truth, notes, files, and use by the filter."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from true_positions import located, true_m

import pdr_filter as pdr
from pdr_filter.filter.step_length.calibration_result import typical_step_m
from pdr_filter.filter.step_length.models import BounceStepLength
from pdr_filter.offline.calibration.fit import calibrate
from pdr_filter.offline.calibration.priors import DEFAULT_PRIORS
from pdr_filter.offline.calibration.segments import integrate, segments_of
from pdr_filter.recipes.calibration import Calibration, load_calibration
from pdr_filter.simulate import Leg, simulate
from pdr_filter.tracking.track import Track
from pdr_filter.values import Samples, table
from pdr_filter.values.recording import Recording, Subject, Truth

pytestmark = pytest.mark.usefixtures("sensing_once")


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate([Leg("walking", distance_m=12.0), *[Leg("walking", distance_m=12.0, turn_rad=1.5)] * 2], seed=3)


@pytest.fixture(scope="module")
def track(recording: Recording) -> Track:
    return pdr.track(recording)


def with_segments(recording: Recording, rows: list[tuple[float, float, float]]) -> Recording:
    columns = np.column_stack([np.array(rows, dtype=float), np.full(len(rows), np.nan)]).T
    segments = table(dict(zip(("start_s", "end_s", "distance_m", "n_steps"), columns, strict=True)))
    return replace(recording, truth=Truth(segments=segments))


def with_points(
    recording: Recording, time_s: np.ndarray, north_m: np.ndarray, floor: float | np.ndarray = 0.0
) -> Recording:
    """A recording of which only waypoints on a line to the north are known."""
    columns = {"time_s": time_s, "east_m": 0.0 * time_s, "north_m": north_m, "floor": floor + 0.0 * time_s}
    return replace(recording, truth=Truth(waypoints=table(columns)))


def test_a_simulated_walk_is_calibrated_to_its_true_length(recording: Recording, track: Track) -> None:
    progress: list[float] = []
    found = calibrate(recording, tracks=[track], progress=progress.append)
    assert progress == [1.0]
    assert found.contexts == ("walking",)
    rows = found.segments
    assert len(rows) == 3
    # the first steps are short, and simulated people do not make shorter ones in turns
    np.testing.assert_allclose(rows.predicted_m, 12.0, rtol=0.17)
    assert list(found.subjects) == ["simulated"]
    assert found.subjects["simulated"].height_m == recording.subject.height_m


def test_bad_rows_of_the_truth_are_not_used_and_named(recording: Recording, track: Track) -> None:
    rows = [(0.0, 9.0, 12.0), (9.0, 5.0, 12.0), (1.0, 5.0, 0.0), (1.0, 5.0, -2.0), (900.0, 909.0, 12.0)]
    found = calibrate(with_segments(recording, rows), tracks=[track])
    assert len(found.segments) == 1
    notes = "\n".join(found.notes)
    assert "end is not after the start (anchors out of time order) in 9.0-5.0 s: not used" in notes
    assert "distance is not positive in 1.0-5.0 s (0 m), 1.0-5.0 s (-2 m): not used" in notes
    assert "no steps in 900.0-909.0 s: not used" in notes
    with pytest.raises(ValueError, match=r"nothing to calibrate with: simulated_walk: .*no steps in"):
        calibrate(with_segments(recording, rows[1:]), tracks=[track])
    with pytest.raises(ValueError, match="has no known lengths, no waypoints and no position fixes"):
        calibrate(replace(recording, truth=Truth()), tracks=[track])


def test_waypoints_out_of_time_order_are_not_used_and_named(recording: Recording, track: Track) -> None:
    time_s = np.array([0.0, 9.3, 18.5, 14.0, 27.0])
    segments, notes = segments_of(with_points(recording, time_s, np.array([0.0, 12, 24, 30, 42])), track)
    assert [s.start_s for s in segments] == [0.0, 9.3, 14.0]
    assert "out of time order) in 18.5-14.0 s" in notes[0]


def with_waypoints(recording: Recording, every_s: float, seed: int = 0) -> Recording:
    time_s = np.arange(1.0, float(recording.truth.position.time_s[-1]), every_s)
    east_m, north_m = true_m(recording, time_s).T + np.random.default_rng(seed).normal(0.0, 0.05, (2, len(time_s)))
    return replace(recording, truth=Truth(waypoints=table({"time_s": time_s, "east_m": east_m, "north_m": north_m})))


@pytest.mark.parametrize("every_s", [0.5, 1.0, 2.0])
def test_dense_waypoints_calibrate_as_well_as_distant_ones(every_s: float) -> None:
    legs = [Leg("walking", distance_m=40.0, turn_rad=1.5), Leg("running", distance_m=40.0)]
    recording = simulate([*legs, *legs], seed=2)
    track = pdr.track(recording)
    dense, _ = segments_of(with_waypoints(recording, every_s), track)
    assert np.median([s.distance_m for s in dense]) >= 10.0
    found, usual = (calibrate(with_waypoints(recording, s), tracks=[track], model="eq12") for s in (every_s, 10.0))
    lengths_m = [pdr.track(recording, calibration=c).step_length_m for c in (found, usual)]
    assert lengths_m[0].sum() == pytest.approx(lengths_m[1].sum(), rel=0.02)
    # steps of walking and of running, without a few where one changes into the other
    assert np.quantile(np.abs(lengths_m[0] / lengths_m[1] - 1.0), 0.98) < 0.1


def test_close_waypoints_are_not_used_and_named_with_their_times(recording: Recording, track: Track) -> None:
    time_s = np.arange(2.0, 20.0, 1.0)
    with pytest.raises(
        ValueError, match=r"nothing to calibrate with: .*waypoints in 2.0-19.0 s are close to each other"
    ):
        calibrate(with_points(recording, time_s, 0.1 * time_s), tracks=[track])


@pytest.mark.parametrize("latitude_deg", [0.0, 48.0, 70.0])
def test_distances_between_locations_are_those_on_the_ellipsoid(
    recording: Recording, track: Track, latitude_deg: float
) -> None:
    origin = pdr.Origin(latitude_deg, 11.0)
    latitude, longitude = origin.latitude_longitude_deg(np.array([[0.0, 0.0], [0.0, 30.0], [40.0, 30.0]]))
    rows = np.column_stack([latitude, longitude, np.full(3, np.nan), np.full(3, 0.1)])
    located = replace(recording, truth=Truth(), location=Samples(np.array([1.0, 12.0, 26.0]), rows))
    segments, _ = segments_of(located, track)
    assert [s.distance_m for s in segments] == pytest.approx([30.0, 40.0], rel=1e-4)


def test_waypoints_on_two_floors_give_no_segment(recording: Recording, track: Track) -> None:
    time_s, north_m, floor = np.array([[0.0, 9.3, 18.5], [0.0, 12.0, 24.0], [0.0, 0.0, 1.0]])
    segments, _ = segments_of(with_points(recording, time_s, north_m, floor), track)
    assert [s.end_s for s in segments] == [9.3]


def test_step_lengths_are_summed_if_a_known_walked_distance_has_a_turn(recording: Recording, track: Track) -> None:
    ends = recording.truth.segments.end_s
    rows = [(0.0, float(ends[0]), 12.0), (float(ends[0]), float(ends[2]), 24.0)]
    found = calibrate(with_segments(recording, rows), tracks=[track])
    assert found.segments.summed.tolist() == [False, True]
    assert any("turns in" in note and "step lengths are summed" in note for note in found.notes)
    np.testing.assert_allclose(found.segments.predicted_m, [12.0, 24.0], rtol=0.11)


def test_a_recording_of_known_distance_is_one_segment_with_its_length_in_the_calibrated_track(
    recording: Recording,
    track: Track,
) -> None:
    known_m = 0.8 * track.distance_m  # shorter steps than usual
    known = recording.of_distance(known_m)
    (segment,), notes = segments_of(known, track)
    assert segment.n_steps == pytest.approx(track.n_steps, abs=1.0)
    assert segment.is_along  # the walk has turns, so that the displacement is shorter
    assert not any("differ" in note for note in notes)
    found = pdr.calibrate([known] * 3, tracks=[track] * 3)
    assert pdr.track(recording, calibration=found).distance_m == pytest.approx(known_m, rel=0.05)


@pytest.mark.parametrize(("share", "is_named"), [(1.0, False), (1.08, False), (1.15, True), (0.85, True)])
def test_a_note_names_segments_whose_counted_steps_differ_by_more_than_a_tenth(
    recording: Recording, track: Track, share: float, is_named: bool
) -> None:
    n_steps = round(share * track.n_steps)
    _, notes = segments_of(recording.of_distance(track.distance_m, n_steps), track)
    assert any(f"{n_steps} counted" in note for note in notes) == is_named


def test_a_stair_in_the_truth_has_a_smaller_error_than_clicked_landmarks(recording: Recording, track: Track) -> None:
    segments, _ = segments_of(with_segments(recording, [(2.0, 2.5, 0.29), (2.0, 9.0, 9.0)]), track)
    assert [s.anchor_std_m for s in segments] == [0.02, 0.35]


def test_without_gyroscope_lengths_are_summed_and_the_report_says_so(recording: Recording, track: Track) -> None:
    found = calibrate(replace(recording, gyroscope=None), tracks=[track])
    assert found.segments.summed.all()
    assert "no gyroscope, so no headings: step lengths are summed" in found.report()


def test_position_fixes_calibrate_a_walk_without_any_truth(recording: Recording, track: Track) -> None:
    """A fix a second along a straight way, good to 2 m."""
    recording = simulate([Leg("walking", distance_m=150.0)], seed=4)
    time_s = np.arange(0.0, float(recording.truth.position.time_s[-1]), 1.0)
    off_m = np.random.default_rng(5).normal(0, 2, (len(time_s), 2))
    found = calibrate(replace(located(recording, time_s, accuracy_m=2 * 1.515, off_m=off_m), truth=Truth()))
    assert 4 <= len(found.segments) <= 8
    exact = calibrate(recording)
    assert found.subjects["simulated"].k0 == pytest.approx(exact.subjects["simulated"].k0, rel=0.08)


def test_recordings_without_subject_are_of_one_person_unless_each_a_person_is_set(
    recording: Recording,
    track: Track,
) -> None:
    nameless = [replace(recording, meta={}, name=name) for name in ("a", "b")]
    one = calibrate(nameless, tracks=[track, track])
    assert set(one.subjects) == {"unnamed"}
    assert any('2 recordings have no subject id: attributed to one person, "unnamed"' in note for note in one.notes)
    assert any("each_a_person (--each-a-person)" in note for note in one.notes)
    anna = calibrate(nameless, tracks=[track, track], subject="anna")
    assert set(anna.subjects) == {"anna"}
    np.testing.assert_array_equal(anna.people, one.people)
    each = calibrate(nameless, tracks=[track, track], each_a_person=True)
    assert set(each.subjects) == {"a", "b"}
    assert any("each is attributed to a different person" in note for note in each.notes)
    named = calibrate([recording, nameless[0]], tracks=[track, track], subject="anna")
    assert set(named.subjects) == {"simulated", "anna"}


def test_recordings_with_one_name_are_different_recordings(recording: Recording, track: Track) -> None:
    apart, alike = (
        calibrate([replace(recording, name=name) for name in names], tracks=[track] * 4)
        for names in (("a", "b", "c", "d"), ("walk", "walk (2)", "walk", "walk"))
    )
    np.testing.assert_array_equal(alike.people_cov, apart.people_cov)
    np.testing.assert_array_equal(alike.segments.left_out_m, apart.segments.left_out_m)
    assert alike.card["recordings"] == 4
    assert list(dict.fromkeys(alike.segments.recording)) == ["walk", "walk (2)", "walk (3)", "walk (4)"]
    nameless = [replace(recording, meta={}, name="walk")] * 2
    each = calibrate([*nameless, replace(recording, name="walk")], tracks=[track] * 3, each_a_person=True)
    assert set(each.subjects) == {"walk", "walk (2)", "simulated"}


@pytest.mark.parametrize(
    ("options", "named"),
    [({"subject": "anna"}, "subject 'anna'"), ({"each_a_person": True}, "each_a_person (--each-a-person)")],
)
def test_an_unneeded_subject_gives_a_note(
    recording: Recording, track: Track, options: dict[str, Any], named: str
) -> None:
    found = calibrate(recording, tracks=[track], **options)
    assert f"every recording has a subject id, so {named} was not used" in found.notes


def test_the_report_has_warnings_about_the_calibration_before_repeated_notes_about_recordings(
    recording: Recording,
    track: Track,
) -> None:
    end_s = float(recording.truth.segments.end_s[2])
    bent = with_segments(recording, [(0.0, end_s, 24.0)])
    many = [replace(bent, name=f"walk {i}") for i in range(20)]
    found = calibrate(many, tracks=[track] * len(many))
    assert sum("turns in" in note for note in found.notes) == len(many)
    lines = found.report().splitlines()
    (of_turns,) = [i for i, line in enumerate(lines) if "turns in" in line]
    assert lines[of_turns].startswith("- walk 0: turns in 0.0-")
    assert lines[of_turns].endswith("instead of step vectors (and 19 similar notes)")
    (of_contexts,) = [i for i, line in enumerate(lines) if "no segments of" in line]
    assert of_contexts < of_turns


# --- what the filter takes of it ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def calibration(recording: Recording, track: Track) -> Calibration:
    return calibrate(recording, tracks=[track])


def test_a_saved_and_loaded_calibration_is_the_same(calibration: Calibration, tmp_path: Path) -> None:
    path = calibration.save(tmp_path / "models" / "me.json")
    for name in (path, path.with_suffix(".npz"), str(path.with_suffix(""))):
        again = load_calibration(name)
        for part in ("theta", "theta_cov", "between_cov", "people", "people_cov", "heights_m"):
            np.testing.assert_array_equal(getattr(again, part), getattr(calibration, part))
        assert again.models == calibration.models
        assert again.report() == calibration.report()
        assert again.scale_std("simulated") == calibration.scale_std("simulated")


def test_damaged_files_are_refused_by_name(calibration: Calibration, tmp_path: Path) -> None:
    path = calibration.save(tmp_path / "me.json")
    with pytest.raises(ValueError, match=r"no_such\.json: no such file"):
        load_calibration(tmp_path / "no_such.json")
    other = tmp_path / "other.json"
    other.write_text(path.read_text(encoding="utf-8"), encoding="utf-8")
    other.with_suffix(".npz").write_bytes(path.with_suffix(".npz").read_bytes()[:-100])
    with pytest.raises(ValueError, match=r"other\.json: not usable as calibration: .*damaged"):
        load_calibration(other)
    path.write_text("{}", encoding="utf-8")
    with pytest.raises(ValueError, match=r"me\.json: not usable as calibration: its kind is None"):
        load_calibration(path)


def test_the_filter_uses_a_calibrated_length_with_its_uncertainty(recording: Recording, track: Track) -> None:
    doubled = with_segments(
        recording,
        [(float(s["start_s"]), float(s["end_s"]), 1.3 * float(s["distance_m"])) for s in recording.truth.segments] * 9,
    )
    found = calibrate(doubled, tracks=[track])
    own = pdr.track(recording, config=found.config(pdr.recipes.default(recording.subject), recording.subject))
    # two of the three lengths begin with a corner, in which simulated people do not make shorter steps
    assert own.distance_m == pytest.approx(1.3 * track.distance_m, rel=0.08)
    assert any("step lengths of simulated: calibrated for walking" in note for note in own.notes)
    stranger = found.config(pdr.recipes.default(), Subject(id="somebody"))
    known = found.config(pdr.recipes.default(), recording.subject)
    assert known.model.noise.log_scale_std < 0.6 * stranger.model.noise.log_scale_std
    # contexts without segments keep their lengths
    for before, after in zip(pdr.recipes.default().model.modes, known.model.modes, strict=True):
        assert (after.step_length is before.step_length) == (after.context != "walking")


def test_a_fit_has_the_height_of_the_person(calibration: Calibration) -> None:
    assert calibration.fits("simulated")["walking"].model == BounceStepLength(1.75)
    assert calibration.fits(Subject(height_m=1.6))["walking"].model == BounceStepLength(1.6)
    assert calibration.fits(Subject(id="somebody"))["walking"].model == BounceStepLength()


def test_a_calibrated_track_names_the_person_of_its_step_lengths(recording: Recording, track: Track) -> None:
    twice = [replace(recording, meta={}, name=name) for name in ("a", "b")]
    one, two = (calibrate(twice, tracks=[track] * 2, each_a_person=each) for each in (False, True))

    def noted(found: Calibration, subject: Subject) -> str:
        notes = found.config(pdr.recipes.default(), subject).notes
        return next(n.text for n in notes if n.about == "step lengths")

    assert "of unnamed, the only calibrated person, because the recording does not name" in noted(one, Subject())
    assert "of the calibrated population (1 person), because bob was not calibrated" in noted(one, Subject(id="bob"))
    assert "of the calibrated population (2 persons), because the recording does not name" in noted(two, Subject())
    assert (
        noted(two, Subject(id="b"))
        == "step lengths of b: calibrated for walking; other contexts keep the step lengths of the recipe"
    )
    np.testing.assert_array_equal(one.fits()["walking"].theta, one.subjects["unnamed"].k["walking"])
    anna = calibrate(twice, tracks=[track] * 2, subject="anna")
    assert "of anna, the only calibrated person, because the recording does not name" in noted(anna, Subject())
    assert one.scale_std() < one.scale_std("bob")
    fit = one.fits("bob")["walking"]
    length_m, std_m = typical_step_m(fit.model, fit.theta, fit.theta_cov + one.between["walking"])
    assert one.scale_std("bob") == pytest.approx(np.hypot(std_m / length_m, one.recording_std))
    tall = calibrate([replace(r, meta={"subject": {"height_m": 1.9}}) for r in twice], tracks=[track] * 2)
    assert tall.person_of(Subject(height_m=1.89)) == "unnamed"
    assert tall.person_of(Subject(height_m=1.6)) is None


def test_the_report_has_people_errors_and_outliers_and_the_figure_is_drawn(
    calibration: Calibration, tmp_path: Path
) -> None:
    text = calibration.report()
    for words in ("3 segments, 36 m", "BounceStepLength", "simulated", "segment held out", "needs two persons"):
        assert words in text
    assert all(len(line) <= 80 for line in text.splitlines() if not line.startswith("- "))
    assert calibration.plot(tmp_path / "new" / "figure.png").axes
    assert (tmp_path / "new" / "figure.png").stat().st_size > 10_000


def test_loading_a_calibration_and_filtering_with_it_needs_no_gtsam(calibration: Calibration, tmp_path: Path) -> None:
    path = calibration.save(tmp_path / "me")
    code = (
        "import sys, pdr_filter as pdr; from pdr_filter.recipes.calibration import load_calibration\n"
        f"c = load_calibration({str(path)!r}); c.config(pdr.recipes.default()); print(c.report())\n"
        "assert not {'gtsam', 'matplotlib', 'pdr_filter.offline'} & set(sys.modules), 'loaded'"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


@pytest.mark.recordings
def test_half_of_the_legs_of_a_person_predict_the_other_half(data_dir: Path) -> None:
    """Two walks of humolire: k from one of them, the other within 5 % (15 legs each).

    He is 1.86 m, which is not given: without a calibration his steps are those of somebody of 1.70 m.
    """
    paths = [data_dir / "humolire" / f"humolire_user1_{name}.zip" for name in ("1f", "2r")]
    recordings = [replace(r, meta={**r.meta, "subject": {"id": "user1"}}) for r in map(pdr.read, paths)]
    tracks = [pdr.track(r) for r in recordings]
    for training, other in ((0, 1), (1, 0)):
        found = calibrate(recordings[training], tracks=[tracks[training]])
        start = {name: DEFAULT_PRIORS[name].mean for name in found.models}
        sums = integrate(segments_of(recordings[other], tracks[other])[0], found.models, start)
        true = sums.distance_m
        uncalibrated, calibrated = (
            np.hypot(*(sums.regressors @ theta).T) for theta in (np.concatenate([*start.values()]), found.people[0])
        )
        assert abs(uncalibrated.sum() / true.sum() - 1) > 0.06
        assert abs(calibrated.sum() / true.sum() - 1) < 0.05
        assert np.sqrt(np.square(calibrated / true - 1).mean()) < 0.08


def test_a_file_with_a_distance_that_nobody_walks_in_that_time_is_refused(recording: Recording, tmp_path: Path) -> None:
    path = recording.of_distance(36.0).save(tmp_path / "walk")
    (path / "truth_segments.csv").write_text("start_s,end_s,distance_m,n_steps\n1.0,9.0,900,\n")
    with pytest.raises(ValueError, match=r"truth_segments.csv: distance_m .* got 900 m in 8.0 s"):
        pdr.read(path)


def test_a_track_says_that_a_calibration_whose_segments_all_contradict_the_steps_is_not_used(
    recording: Recording, track: Track, tmp_path: Path
) -> None:
    wrong = pdr.calibrate(recording.of_distance(2.6 * track.distance_m))
    assert wrong.distrusted.shape == wrong.segments.shape == (1,)
    for known in (wrong, wrong.save(tmp_path / "wrong.json")):
        found = pdr.track(recording, calibration=known)
        np.testing.assert_array_equal(found.position_m, pdr.track(recording).position_m)
        (note,) = (note for note in found.notes if "step lengths of" in note)
        assert "no context is calibrated" in note
        assert "1 of 1 segment of the calibration contradict the detected steps" in note
    right = pdr.calibrate(recording.of_distance(track.distance_m))
    assert not any("contradict" in note for note in pdr.track(recording, calibration=right).notes)
