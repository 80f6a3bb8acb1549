"""GNSS until the person enters a building; dead reckoning continues inside, in the world frame."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import pdr_filter as pdr
from pdr_filter.simulate import Leg, simulate

here = pdr.Origin(48.137, 11.575)  # start of the walk
legs = [Leg("walking", distance_m=110.0), Leg("walking", distance_m=60.0, turn_rad=1.2)]
walk = simulate(legs, seed=4, start_heading_rad=0.7)  # headings are relative to magnetic north
truth, rng, east_of_north_rad = walk.truth.position, np.random.default_rng(0), here.declination_rad()
c, s = np.cos(east_of_north_rad), np.sin(east_of_north_rad)
true_m = np.column_stack([truth.east_m, truth.north_m]) @ np.array([[c, s], [-s, c]]).T

time_s = np.arange(1.0, 75.0)  # the door is reached after 75 s
place_m = np.column_stack([np.interp(time_s, truth.time_s, true_m[:, k]) for k in (0, 1)])
latitude_deg, longitude_deg = here.latitude_longitude_deg(place_m + rng.normal(0.0, 3.0, place_m.shape))
accuracy_m = np.full(len(time_s), 5.0)  # accuracy as reported by the phone: radius of 68 %
location = pdr.Samples(time_s, np.column_stack([latitude_deg, longitude_deg, np.zeros(len(time_s)), accuracy_m]))

track = pdr.track(replace(walk, location=location))  # as `pdr.read` gives it
print(track.report())
track.to_geojson("gnss_then_indoors.geojson")
on_map = here.east_north_m(track.latitude_deg, track.longitude_deg)
end_m = np.linalg.norm(on_map[-1] - true_m[-1])
print(f"{end_m:.1f} m from the truth, {track.time_s[-1] - 75:.0f} s after the last fix")

figure, axes = plt.subplots()
axes.plot(*true_m.T, "k--", label="truth")
axes.plot(*here.east_north_m(latitude_deg, longitude_deg).T, ".", label="GNSS")
axes.plot(*on_map.T, label="filter")
axes.set(xlabel="east, m", ylabel="north, m", aspect="equal")
axes.legend()
figure.savefig("gnss_then_indoors.png")
