"""Wi-Fi of a shopping mall: a radio map on walks left out of it, and loops closed by scans that are alike.

usage: python -m tests.benchmarks.radio [choice] [alike] [fixes] [storeys] [walks] [start] [loops] [--data DIR]

99 walks of `ms_indoor` with Wi-Fi on five storeys, 40 on F1 and 14 or 15 on each other one. Kernel, noise, evidence,
variances and likeness were chosen on F1 (choice, loops); what is reported are the others beside it. A walk is never in
the map that it is located with: the map is that of all other walks of its storey, placed between their waypoints by
`pdr_filter.smooth`. Truth at a scan is the walk's own such track, at a waypoint the waypoint.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
from sklearn.neighbors import KNeighborsRegressor

import pdr_filter as pdr
from pdr_filter.maps.radio import radio_map
from pdr_filter.maps.radio import signal_field as field
from pdr_filter.offline.smoothing.observations import waypoint_fixes
from pdr_filter.offline.smoothing.wifi_loops import ALIKE, wifi_loop_closures
from tests.benchmarks.common import Tables, median_and, options, paths

CHOSEN_ON = "f1"
# chi-square with two degrees of freedom, 50 and 95 %
HALF, MOST = 1.386, 5.991
START_STD_RAD = np.radians(10.0)


@dataclass(frozen=True, eq=False)
class Known:
    """A walk and where it was."""

    recording: pdr.Recording
    track: pdr.Track  # between its waypoints
    points: np.ndarray  # (W, 3) time, east, north

    @property
    def storey(self) -> str:
        return self.recording.name.split("_")[4]

    def place(self, time_s: float) -> np.ndarray:
        return place(self.track, time_s)


def place(track: pdr.Track, time_s: float) -> np.ndarray:
    times = np.concatenate([[min(track.start_time_s, track.time_s[0]) - 1e-3], track.time_s])
    position = np.vstack([track.start_position_m, track.position_m])
    return np.array([np.interp(time_s, times, axis) for axis in position.T])


def known_walks(data: Path) -> list[Known]:
    found: list[Known] = []
    for path in paths(data, "ms_indoor"):
        recording = pdr.read(path)
        if recording.wifi is None:
            continue
        w = recording.truth.waypoints
        track = pdr.smooth(recording, waypoint_fixes(recording)).track
        found.append(Known(recording, track, np.column_stack([w.time_s, w.east_m, w.north_m])))
    return found


def map_of(walks: Sequence[Known]) -> pdr.RadioMap:
    """With storeys, which tracks do not say."""
    maps = [pdr.RadioMap.fit([(k.recording, k.track)]) for k in walks]
    bssid = np.unique(np.concatenate([m.bssid for m in maps]))
    before = np.cumsum([0, *(len(m.floor) for m in maps)])
    floors = [float(k.recording.truth.waypoints.floor[0]) for k in walks]
    return pdr.RadioMap(
        position_m=np.concatenate([m.position_m for m in maps]),
        floor=np.concatenate([np.full(len(m.floor), f) for m, f in zip(maps, floors, strict=True)]),
        bssid=bssid,
        point=np.concatenate([m.point + n for m, n in zip(maps, before[:-1], strict=True)]),
        access_point=np.concatenate([np.searchsorted(bssid, m.bssid[m.access_point]) for m in maps]),
        rssi_dbm=np.concatenate([m.rssi_dbm for m in maps]),
    )


def left_out(walks: Sequence[Known]) -> Iterator[tuple[Known, list[Known]]]:
    """Each walk with all others of its storey."""
    for walk in walks:
        yield walk, [k for k in walks if k is not walk and k.storey == walk.storey]


def located(walks: Sequence[Known]) -> dict[str, list[pdr.PositionFix]]:
    """Fixes of each walk by the map of the others of its storey."""
    return {walk.recording.name: map_of(others).fixes(walk.recording) for walk, others in left_out(walks)}


# --- fixes -----------------------------------------------------------------------------------------------------------


def scores(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[str]:
    """Of errors (2,) and covariances (2, 2): how many, how far, in 50 and 95 % regions, mean log density."""
    error, cov = np.array([e for e, _ in pairs]), np.array([c for _, c in pairs])
    nees = np.einsum("fa,fab,fb->f", error, np.linalg.inv(cov), error)
    loss = 0.5 * nees + 0.5 * np.log(np.linalg.det(cov)) + np.log(2 * np.pi)
    shares = [f"{100 * (nees < limit).mean():.0f} %" for limit in (HALF, MOST)]
    far = np.hypot(*error.T)
    return [
        str(len(error)),
        f"{np.median(far):.1f} m",
        f"{np.percentile(far, 90):.1f} m",
        *shares,
        f"{loss.mean():.2f}",
    ]


def errors_of(walk: Known, fixes: Sequence[pdr.PositionFix]) -> list[tuple[np.ndarray, np.ndarray]]:
    return [(walk.place(f.time_s) - f.position_m, f.cov_m2) for f in fixes]


def neighbours(walks: Sequence[Known], others: Sequence[Known], k: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Errors of the mean of the k scans of the map that are most alike; covariance of them, and of the map's own."""
    radio = map_of(others)
    scans = field.fingerprints(radio.point, radio.access_point, radio.rssi_dbm, (len(radio.floor), len(radio.bssid)))
    machine = KNeighborsRegressor(k, weights="distance", metric="cosine").fit(scans, radio.position_m)
    found: list[tuple[np.ndarray, np.ndarray]] = []
    for walk in walks:
        heard = [s for s in walk.recording.wifi.scans() if np.isin(s.bssid, radio.bssid).sum() >= 5]
        if not heard:
            continue
        queries = radio._heard(heard)
        nearest = radio.position_m[machine.kneighbors(queries, return_distance=False)]
        for scan, at, around in zip(heard, machine.predict(queries), nearest, strict=True):
            cov = np.cov(around.T) + radio_map._OWN_VAR_M2 * np.eye(2)
            found.append((walk.place(scan.time_s) - at, cov))
    return found


@contextmanager
def chosen(**constants: float) -> Iterator[None]:
    """Other constants of the field and of the map for a while."""
    homes = {name: field if hasattr(field, name) else radio_map for name in constants}
    before = {name: getattr(home, name) for name, home in homes.items()}
    for name, home in homes.items():
        setattr(home, name, constants[name])
    yield
    for name, home in homes.items():
        setattr(home, name, before[name])


def choice(walks: Sequence[Known], tables: Tables) -> None:
    """What the constants were chosen by, all on F1: maps of two walks in three, and of one in three; every scan."""
    here = [k for k in walks if k.storey == CHOSEN_ON]
    thirds = [here[i::3] for i in range(3)]
    splits: list[tuple[list[Known], list[Known]]] = []
    splits += [(third, [k for k in here if k not in third]) for third in thirds]
    sparse = [([k for k in here if k not in third], third) for third in thirds]
    rows: list[list[str]] = []
    settings: list[dict[str, float]] = [
        {},
        *({"LENGTH_M": v} for v in (20.0, 80.0)),
        *({"NOISE": v} for v in (0.1, 0.5)),
        *({"EVIDENCE": v} for v in (15.0, 30.0)),
        {"MARGIN_M": 15.0},
        *({"_OWN_VAR_M2": v} for v in (2.0, 10.0)),
    ]
    for setting in settings:
        name = ", ".join(f"{n.strip('_').lower()} {v:g}" for n, v in setting.items()) or "as chosen"
        with chosen(_INTERVAL_SHARE=0.0, _WIDEST_STD_M=np.inf, **setting):
            for dense, split in ((True, splits), (False, sparse)):
                pairs = [e for asked, mapped in split for e in _errors_by(map_of(mapped), asked)]
                rows.append([name, "27" if dense else "13", *scores(pairs)])
    for k in (3, 8):
        for dense, split in ((True, splits), (False, sparse)):
            pairs = [e for asked, mapped in split for e in neighbours(asked, mapped, k)]
            rows.append([f"{k} nearest neighbours", "27" if dense else "13", *scores(pairs)])
    columns = ["field", "walks in the map", "scans", "median", "90 %", "in 50 % region", "in 95 %", "-log density"]
    about = (
        f"F1, 40 walks in three groups; each asked of maps of the others. As chosen: length {field.LENGTH_M:g} m, "
        f"noise {field.NOISE:g}, evidence {field.EVIDENCE:g}, own variance {radio_map._OWN_VAR_M2:g} m2. Neighbours: "
        "cosine distance, their own covariance and the same own variance."
    )
    tables.write("radio_choice", columns, rows, about)


def _errors_by(radio: pdr.RadioMap, asked: Sequence[Known]) -> list[tuple[np.ndarray, np.ndarray]]:
    return [e for walk in asked for e in errors_of(walk, radio.fixes(walk.recording))]


def by_storey(walks: Sequence[Known]) -> Iterator[tuple[str, list[Known]]]:
    for storey in sorted({k.storey for k in walks}):
        yield storey.upper() + (" (chosen on)" if storey == CHOSEN_ON else ""), [k for k in walks if k.storey == storey]
    yield "all but F1", [k for k in walks if k.storey != CHOSEN_ON]


def errs_alike(walks: Sequence[Known], tables: Tables) -> None:
    """How long errors on F1 stay alike, by how wide the fixes are: what `correlation_s` was chosen by; every scan."""
    edges_m, apart_s = (0.0, 4.5, 7.0, 10.0, 20.0, 100.0), (1.0, 4.0, 7.0, 11.0, 16.0, 24.0, 40.0)
    found: list[np.ndarray] = []
    with chosen(_INTERVAL_SHARE=0.0, _WIDEST_STD_M=np.inf):
        for walk, others in left_out([k for k in walks if k.storey == CHOSEN_ON]):
            fixes = map_of(others).fixes(walk.recording)
            whitened = [np.linalg.solve(np.linalg.cholesky(c), e) for e, c in errors_of(walk, fixes)]
            for (a, u), (b, v) in combinations(list(zip(fixes, whitened, strict=True)), 2):
                width_m = np.sqrt(np.sqrt(a.var_m2 * b.var_m2))
                found.append(np.array([b.time_s - a.time_s, width_m, u @ v, 0.5 * (u @ u + v @ v)]))
    time_s, width_m, product, square = np.array(found).T
    rows: list[list[object]] = []
    for low, high in pairwise(edges_m):
        inside = (width_m >= low) & (width_m < high)
        row: list[object] = [f"{low:g} to {high:g} m", int(inside.sum())]
        for after, before in pairwise(apart_s):
            pairs = inside & (time_s >= after) & (time_s < before)
            row.append(f"{product[pairs].mean() / square[inside].mean():.2f}" if pairs.sum() > 20 else "-")
        rows.append(row)
    columns = ["standard deviation", "pairs", *(f"{a:g} to {b:g} s" for a, b in pairwise(apart_s))]
    about = (
        "Correlation of the errors of two scans of one walk on F1, in units of their covariance, by the time between."
    )
    tables.write("radio_alike", columns, rows, about)


def of_fixes(walks: Sequence[Known], fixes: dict[str, list[pdr.PositionFix]], tables: Tables) -> None:
    rows: list[list[str]] = []
    for name, group in by_storey(walks):
        asked = [s for k in group for s in k.recording.wifi.scans()]
        pairs = [e for k in group for e in errors_of(k, fixes[k.recording.name])]
        without = sum(not fixes[k.recording.name] for k in group)
        rows.append([name, str(len(group)), str(without), str(len(asked)), *scores(pairs)])
    columns = [
        "storey",
        "walks",
        "without a fix",
        "scans",
        "fixes",
        "median",
        "90 %",
        "in 50 % region",
        "in 95 %",
        "-log density",
    ]
    about = "Each walk by the map of all others of its storey."
    tables.write("radio_fixes", columns, rows, about)


def storeys(walks: Sequence[Known], tables: Tables) -> None:
    """Which storey, by one map of all five, without a tenth of the walks at a time."""
    told: dict[str, list[tuple[int | None, int]]] = {}
    for i in range(10):
        asked = list(walks[i::10])
        radio = map_of([k for k in walks if k not in asked])
        for k in asked:
            true = int(k.recording.truth.waypoints.floor[0])
            told.setdefault(k.storey, []).extend((f.floor, true) for f in radio.fixes(k.recording))
    rows: list[list[object]] = []
    for storey, pairs in sorted(told.items()):
        said = [(f, true) for f, true in pairs if f is not None]
        right = sum(f == true for f, true in said)
        rows.append(
            [storey.upper(), len(pairs), f"{100 * len(said) / len(pairs):.0f} %", f"{100 * right / len(said):.1f} %"]
        )
    about = "One map of all storeys, of nine tenths of the walks."
    tables.write("radio_storeys", ["storey", "fixes", "storey said", "of these right"], rows, about)


# --- walks -----------------------------------------------------------------------------------------------------------


def from_start(walk: Known, fixes: Sequence[pdr.PositionFix]) -> tuple[np.ndarray, list[pdr.PositionFix]]:
    """Waypoints and fixes where the first waypoint is the origin and the first leg points north."""
    east_m, north_m = walk.points[1, 1:] - walk.points[0, 1:]
    heading = np.arctan2(east_m, north_m)
    turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    points = np.column_stack([walk.points[:, 0], (walk.points[:, 1:] - walk.points[0, 1:]) @ turn.T])
    turned = [
        replace(f, position_m=turn @ (f.position_m - walk.points[0, 1:]), cov_m2=turn @ f.cov_m2 @ turn.T)
        for f in fixes
    ]
    return points, turned


def mean_error_m(track: pdr.Track, points: np.ndarray) -> float:
    """At the waypoints after the first."""
    return float(np.mean([np.hypot(*(place(track, t) - (e, n))) for t, e, n in points[1:]]))


def of_walks(walks: Sequence[Known], fixes: dict[str, list[pdr.PositionFix]], tables: Tables) -> None:
    names = ("dead reckoning", "+ radio map", "smoothed", "+ loops", "+ radio map", "+ both")
    rows: list[list[str]] = []
    all_errors: list[list[float]] = []
    for walk in walks:
        points, radio = from_start(walk, fixes[walk.recording.name])
        here = pdr.PositionFix(points[0, 0], points[0, 1:], 0.25 * np.eye(2))

        def smoothed(
            known: list[pdr.PositionFix], loops: bool = False, walk: Known = walk, here: pdr.PositionFix = here
        ) -> pdr.Track:
            closed = wifi_loop_closures(walk.recording) if loops else ()
            found = pdr.smooth(
                walk.recording, [here, *known], loop_closures=closed, start_heading_std_rad=START_STD_RAD
            )
            return found.track

        runs: tuple[Callable[[], pdr.Track], ...] = (
            lambda walk=walk, here=here: pdr.track(walk.recording, fixes=[here]),
            lambda walk=walk, here=here, radio=radio: pdr.track(walk.recording, fixes=[here, *radio]),
            lambda run=smoothed: run([]),
            lambda run=smoothed: run([], True),
            lambda run=smoothed, radio=radio: run(radio),
            lambda run=smoothed, radio=radio: run(radio, True),
        )
        errors = [mean_error_m(run(), points) for run in runs]
        all_errors.append(errors)
        short = walk.recording.name.removeprefix("ms_indoor_anon_site1_")
        about = [f"{walk.recording.duration_s:.0f} s", str(len(points) - 1), str(len(radio))]
        rows.append([short[:2].upper() + " " + short[-4:], *about, *(f"{e:.1f}" for e in errors)])
    columns = ["walk", "time", "waypoints", "fixes", *names]
    about = (
        "Mean error at the waypoints after the first, m; the first waypoint and the direction of the first leg given."
    )
    tables.write("radio_walks", columns, rows, about)
    error = np.array(all_errors)
    long = np.array([k.recording.duration_s >= 45 for k in walks])
    summary: list[list[str]] = []
    for name, group in (
        *by_storey(walks),
        ("45 s and longer, all but F1", [k for k in walks if k.storey != CHOSEN_ON]),
    ):
        chosen_rows = np.array([k in group for k in walks]) & (long | (not name.startswith("45")))
        e = error[chosen_rows]
        worse = (e > 1.1 * e[:, :1]).mean(axis=0)
        cells = [f"{median_and(e[:, j], 90, 1)} ({100 * worse[j]:.0f} %)" for j in range(len(names))]
        summary.append([name, str(len(e)), *cells])
    tables.write(
        "radio_main",
        ["storey", "walks", *names],
        summary,
        "Median and 90 % of the walks' errors, m, and the share of walks that is worse than 1.1 times dead reckoning.",
    )


def start(walks: Sequence[Known], fixes: dict[str, list[pdr.PositionFix]], tables: Tables) -> None:
    """Nothing is given but the map."""
    rows: list[list[str]] = []
    tracks = {
        k.recording.name: pdr.track(
            k.recording,
            pdr.recipes.default(k.recording.subject).in_world_frame(),
            fixes=fixes[k.recording.name],
        )
        for k in walks
    }
    for name, group in by_storey(walks):
        for after_s in (30.0, 60.0, 120.0):
            long = [k for k in group if k.track.time_s[-1] >= after_s]
            if not long:
                rows.append([name, f"{after_s:.0f} s", "0", *["-"] * 6])
                continue
            error, outside = [], []
            for k in long:
                track = tracks[k.recording.name]
                if not any(f.accepted and f.used_s <= after_s for f in track.fixes):
                    continue
                i = int(np.searchsorted(track.time_s, after_s, side="right")) - 1
                e = k.place(track.time_s[i]) - track.position_m[i]
                error.append(np.hypot(*e))
                outside.append(e @ np.linalg.solve(track.position_cov_m2[i], e) > MOST)
            shares = [f"{100 * np.sum(np.array(error) < m) / len(long):.0f} %" for m in (3, 5, 10)]
            median = f"{np.median(error):.1f} m" if error else "-"
            row = [str(len(error)), median, *shares, f"{100 * np.sum(outside) / len(long):.0f} %"]
            rows.append([name, f"{after_s:.0f} s", str(len(long)), *row])
    columns = [
        "storey",
        "after",
        "walks",
        "placed",
        "their median",
        "within 3 m",
        "5 m",
        "10 m",
        "outside of the 95 % ellipse",
    ]
    about = "Start and direction unknown: `track(recording, config.in_world_frame(), fixes=radio.fixes(recording))`. "
    about += "Shares are of all walks that last so long; one without a fix is not placed, and says so (`Track.frame`)."
    tables.write("radio_start", columns, rows, about)


# --- loops -----------------------------------------------------------------------------------------------------------

BINS = (0.6, 0.7, 0.8, ALIKE, 0.9, 0.95)


def loops(walks: Sequence[Known], tables: Tables) -> None:
    """How far apart scans are that are so alike: pairs of scans of two walks."""
    scans = [[s for s in k.recording.wifi.scans() if len(s.bssid) >= 20] for k in walks]
    place_m = [np.array([k.place(s.time_s) for s in own]).reshape(-1, 2) for k, own in zip(walks, scans, strict=True)]
    every = [s for own in scans for s in own]
    known = np.unique(np.concatenate([s.bssid for s in every]))
    heard = field.fingerprints(
        np.repeat(np.arange(len(every)), [len(s.bssid) for s in every]),
        np.searchsorted(known, np.concatenate([s.bssid for s in every])),
        np.concatenate([s.rssi_dbm for s in every]),
        (len(every), len(known)),
    )
    first = np.cumsum([0, *map(len, scans)])
    parts = [heard[a:b] for a, b in pairwise(first)]
    pairs: dict[str, list[np.ndarray]] = {"F1": [], "other storeys": [], "two storeys": []}
    for (i, a), (j, b) in combinations(enumerate(walks), 2):
        likeness = (parts[i] @ parts[j].T).toarray().ravel()
        far = np.linalg.norm(place_m[i][:, None] - place_m[j], axis=-1).ravel()
        kind = "two storeys" if a.storey != b.storey else "F1" if a.storey == CHOSEN_ON else "other storeys"
        pairs[kind].append(np.column_stack([likeness, far]))
    rows: list[list[str]] = []
    for low, high in zip(BINS, (*BINS[1:], 1.01), strict=True):
        row = [f"{low:g} to {min(high, 1.0):g}"]
        for kind in ("F1", "other storeys"):
            both = np.concatenate(pairs[kind])
            far = both[(both[:, 0] >= low) & (both[:, 0] < high), 1]
            std = np.sqrt(np.mean(far**2) / 2)
            beyond = f"{100 * np.mean(far > 3 * 7.5):.1f} %"
            row += [str(len(far)), median_and(far, 90, 1), f"{std:.1f}", beyond]
        across = np.concatenate(pairs["two storeys"])[:, 0]
        row.append(f"{int(((across >= low) & (across < high)).sum())} of {len(across)}")
        rows.append(row)
    each = ["pairs", "median, 90 % m", "std of an axis m", "over 22.5 m"]
    columns = ["cosine", *(f"{kind}: {c}" for kind in ("F1", "others") for c in each), "on two storeys"]
    about = (
        "Pairs of scans of different walks with 20 access points or more; `LoopClosure` from 0.85 on, 7.5 m an axis."
    )
    tables.write("radio_loops", columns, rows, about)


def main() -> None:
    arguments = options(__doc__, "choice", "alike", "fixes", "storeys", "walks", "start", "loops").parse_args()
    tables = Tables.of("tests.benchmarks.radio", arguments)
    walks = known_walks(arguments.data)
    if "loops" in arguments.parts:
        loops(walks, tables)
    if "storeys" in arguments.parts:
        storeys(walks, tables)
    if "alike" in arguments.parts:
        errs_alike(walks, tables)
    if "choice" in arguments.parts:
        choice(walks, tables)
    if {"fixes", "walks", "start"} & set(arguments.parts):
        fixes = located(walks)
        for part, run in (("fixes", of_fixes), ("start", start), ("walks", of_walks)):
            if part in arguments.parts:
                run(walks, fixes, tables)


if __name__ == "__main__":
    main()
