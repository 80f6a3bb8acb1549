"""Limits of the readers, each with its reason: the sizes that a file may have, and the plausible values of a recording.

Other modules use them as `limits.NAME`, so that tests can lower a limit.
"""

from __future__ import annotations

# Maximum size of one file. A day of samples at 400 Hz is 1.3 GB of text for each of three sensors.
MAX_MEMBER_BYTES = 2 * 1024**3
MAX_READ_BYTES = 4 * 1024**3  # all files of a recording
# All files of a recording that is read in parts: eight months of three sensors at 400 Hz.
MAX_PARTS_BYTES = 1024**4
# Maximum ratio of the unpacked size of a zip file to its own size, also for the claimed size of an array or a sparse
# file. 588 recordings of phones have ratios up to 3.9. Two hours of constant values in the most verbose formats
# (phyphox, CoreMotion) have up to 24. Deflate can reach 1000. In memory, text takes up to six times its size.
MAX_COMPRESSION_RATIO = 30
UNPACKED_FREELY_BYTES = 4 * 1024**2  # unpacked at any ratio
# A recording has tens of files. A hostile zip file may list a million.
MAX_MEMBERS = 10_000
# Inspecting the first lines of more files takes longer than reading a recording.
MAX_FILES_LOOKED_AT = 100
# Files are parsed in blocks of this size, so that the text of a recording is never in memory as a whole.
BLOCK_BYTES = 4 * 1024**2
# Rows of sensor data have some hundred bytes, and lines of a header some thousand.
MAX_LINE_BYTES = 1024**2
HEAD_BYTES = 65_536  # first lines of a file, from which its format is detected
MAX_HEADER_BYTES = 100_000  # comment lines before the samples of a log
MAX_HEADER_LINES = 1000
# Small files of a recording, such as meta.json, have some kilobytes. Parsed, they take about thirty times as much.
MAX_SMALL_BYTES = 1_000_000
# Models, calibrations and fixes are read as a whole. A shipped model has 0.4 MB, a day of fixes 4 MB.
MAX_DESCRIPTION_BYTES = 4 * 1024**2  # JSON
MAX_PLAN_BYTES = 8 * 1024**2  # a floor plan of a mall has 0.15 MB
MAX_WHOLE_BYTES = 64 * 1024**2
MAX_UNPACKED_BYTES = 256 * 1024**2
MAX_FIXES = 24 * 3600 * 2
# A TOML file describes the columns of a table. Its parser takes a second for some megabytes.
MAX_TOML_BYTES = 100_000
MAX_COLUMNS = 1000  # columns of a table
# Text labels of stretches of a walk, at most one per second of a day. NumPy stores each at the width of the longest.
MAX_TEXT_ROWS = 24 * 3600
MAX_TABLES = 100  # a phyphox experiment has about ten
MAX_ARRAY_ROWS = 24 * 3600 * 200  # a day at 200 Hz, because hdf5 is read into memory at once
HEAD_ROWS = 200  # first rows of a sensor, from which the start of the recording is determined
# Limits on the texts of a file that become meta data of a recording: their numbers, and their lengths in characters.
MAX_ANNOTATIONS = 1000
MAX_SENTENCES = 50
MAX_NAME_CHARS = 200
MAX_TEXT_CHARS = 500

# A longer interval between the samples of a fast sensor is a gap: a step can be missed within it.
GAP_S = 0.3
# A slow sensor (GNSS at 1 Hz) has a gap where an interval is longer than this number of usual intervals.
GAP_INTERVALS = 2.5
# Largest magnitude of a given heading, in degrees: a whole turn in both directions. A larger one in radians is a number
# in degrees.
MAX_HEADING_DEG = 360.0
# Largest distance of a given fix from the origin of the track. Nobody walks further in a day, and an exchanged latitude
# and longitude are thousands of kilometres away, except near the line on which both are equal.
MAX_FIX_DISTANCE_M = 100e3
# Maximum distance in time for interpolating gravity to the times of the accelerometer. Gravity rotates less in this
# time than in the swing of a step.
GRAVITY_GAP_S = 0.3

# Largest plausible measured value. Squares and sums of squares do not overflow.
LARGEST_VALUE = 1e30
MAX_INT64 = 2**63 - 1
# Largest integer time. Differences fit into an int64. In nanoseconds the range covers the years 1824 to 2116.
MAX_WHOLE_TIME = 2**62
MAX_ELAPSED_S = 1e9
MAX_EPOCH_S = 253_402_300_799.0  # last second of the year 9999, the end of common calendar functions
HEIGHT_RANGE_M = (0.4, 2.8)
# Steps of toddlers and of people who shuffle are 0.1 to 0.3 m long, those of sprinters up to 2.7 m. Lengths in
# centimetres are outside of the range.
STEP_LENGTH_RANGE_M = (0.05, 3.0)
# Largest mean step length of a walk without running. Race walkers, the longest walking steps, have 1.1 to 1.3 m.
MAX_WALKING_STEP_M = 1.4
MAX_SPEED_MPS = 12.5  # nobody has run faster than 12.4 m/s

# Minimum number of samples of a recording. Fewer cannot contain a step at any plausible rate.
MIN_SAMPLES = 10
# Steps have a frequency of 2 Hz, so that a rate below 5 Hz cannot represent them. No phone exceeds 2000 Hz. The range
# spans less than a factor of 1000, so that at most one of ms, us and ns explains a rate outside of it.
RATE_RANGE_HZ = (5.0, 2000.0)
# At 25 Hz the steps of 66 real walks are counted as accurately as at 100 Hz (docs/tables/steps_counts.md). Simulated
# walks at 5 Hz lose almost half of their steps.
SUFFICIENT_RATE_HZ = 25.0
# The median |specific force| of 349 real recordings is 8.6 to 15.5 m/s2 (the largest from jogging with the phone in the
# pocket), which is 0.9 to 1.6 in g. Walking without gravity has about 1 to 4, so that the message for small values
# names both causes.
SPECIFIC_FORCE_RANGE_MPS2 = (5.0, 25.0)
G_RANGE = (0.8, 1.7)
# Two revolutions per second as the median. Jogging reaches 4.3 rad/s, and a walk in deg/s has 20 or more.
MAX_MEDIAN_ANGULAR_RATE_RADPS = 12.0
MAGNETIC_FIELD_RANGE_UT = (20.0, 80.0)  # 22 to 67 uT on Earth, with a margin for steel in buildings
PRESSURE_RANGE_HPA = (500.0, 1100.0)  # from an altitude of 5000 m to a deep valley
QUATERNION_NORM_RANGE = (0.98, 1.02)
# Mean cosine between up and the specific force that is rotated into the world by the phone's own attitude. It is 0.9 or
# more in a walk with the right sign, and -0.9 with the wrong sign. Attitudes never aligned with gravity are in between.
UP_COSINE_WRONG_SIGN = -0.5
UP_COSINE_DOUBTFUL = 0.5
# A stretch of known walked distance has a turn if its displacement is below this share of the walked distance. One or
# two steps around a corner at the ends of a leg of ten steps give 0.92. Half of the leg at a right angle gives 0.71.
STRAIGHT = 0.85
