"""App that pushes samples as they arrive and draws the track with its 95 % ellipse."""

import sys

import matplotlib.pyplot as plt
import numpy as np

import pdr_filter as pdr

recording = pdr.read(sys.argv[1]) if len(sys.argv) > 1 else pdr.simulate.demo_walk()  # takes the place of the sensors
samples = pdr.merge_streams(recording)
online = pdr.OnlineFilter(pdr.recipes.default(recording.subject))
places = [np.zeros(2)]
figure, axes = plt.subplots()
(line,) = axes.plot([], [])
(ellipse,) = axes.plot([], [])
axes.set(xlabel="east, m", ylabel="north, m", aspect="equal")
circle = np.array([np.cos(np.linspace(0, 2 * np.pi, 60)), np.sin(np.linspace(0, 2 * np.pi, 60))])

for start in range(0, len(samples.time_s), 50):  # half a second at 100 Hz; any length will do
    part = slice(start, start + 50)
    updates = online.push(samples.time_s[part], samples.specific_force_mps2[part], samples.angular_rate_radps[part])
    places += [update.position_m for update in updates]
    if updates:
        line.set_data(*np.array(places).T)
        ellipse.set_data(*(places[-1][:, None] + 2.45 * np.linalg.cholesky(online.position_cov_m2) @ circle))
        axes.relim()
        axes.autoscale_view()
        plt.pause(0.001)

updates = online.finish()
print(f"{len(places) - 1 + len(updates)} steps, end at {np.round(online.position_m, 1)} m", *online.notes, sep="\n")
figure.savefig("live_track.png")
