"""GNSS fixes in the metres of a map until the person enters a building; the filter goes on from there."""

import matplotlib.pyplot as plt
import numpy as np

import pdr_filter as pdr
from pdr_filter.simulate import Leg, simulate

walk = simulate([Leg("walking", distance_m=70.0), Leg("walking", distance_m=60.0, turn_rad=1.2)], seed=4)
truth, rng = walk.truth.position, np.random.default_rng(0)
origin_m, north_rad = np.array([350.0, 120.0]), 0.7  # where the walk really starts on the map, and how it is turned
turn = np.array([[np.cos(north_rad), np.sin(north_rad)], [-np.sin(north_rad), np.cos(north_rad)]])
on_map = np.column_stack([truth.east_m, truth.north_m]) @ turn.T + origin_m

fixes = []
for t in np.arange(2.0, 45.0, 2.0):  # the door is reached after 45 s
    place = np.array([np.interp(t, truth.time_s, on_map[:, k]) for k in (0, 1)])
    fixes.append(pdr.PositionFix(t, place + rng.normal(0.0, 3.0, 2), 9.0 * np.eye(2), received_time_s=t + 0.8))

config = pdr.recipes.default(walk.subject).in_world_frame()  # the filter knows neither the place nor the north
track = pdr.track(walk, config, fixes=fixes)
print(track.report())
end_m = np.linalg.norm(track.position_m[-1] - on_map[-1])
print(f"{end_m:.1f} m from the truth, {track.time_s[-1] - 45:.0f} s after the last fix")

figure, axes = plt.subplots()
axes.plot(*on_map.T, "k--", label="truth")
axes.plot(*np.array([fix.position_m for fix in fixes]).T, ".", label="GNSS")
axes.plot(*track.position_m.T, label="filter")
axes.set(xlabel="east, m", ylabel="north, m", aspect="equal")
axes.legend()
figure.savefig("gnss_then_indoors.png")
