"""Every bound of the readers, with its reason: on what a file may claim, and on what a recording may plausibly hold.

Used as `limits.NAME`, so that a test can lower one of them.
"""

from __future__ import annotations

# A day of 400 Hz samples in three sensors is 1.3 GB of text each. More than this is a mistake or an attack.
MAX_MEMBER_BYTES = 2 * 1024**3
MAX_READ_BYTES = 4 * 1024**3  # of all files of a recording
# How many times its own size a zip file may unpack to, and an array or a sparse file claim. 588 recordings of phones
# unpack to 3.9 times at most, two hours of constant values in the most wordy formats (phyphox, CoreMotion) to 24 times;
# deflate can reach 1000. As numbers, text takes up to six times its size.
MAX_COMPRESSION_RATIO = 30
UNPACKED_FREELY_BYTES = 4 * 1024**2  # harmless, whatever the size
# A recording has tens of files; listing a million members of a hostile zip is refused.
MAX_MEMBERS = 10_000
# Looking at the first lines of more files than this takes longer than reading a recording.
MAX_FILES_LOOKED_AT = 100
# Files are parsed in blocks of this size, so that the text of a recording never is in memory as a whole.
BLOCK_BYTES = 4 * 1024**2
# Rows of sensor data have some hundred bytes, and one line of a header some thousand.
MAX_LINE_BYTES = 1024**2
HEAD_BYTES = 65_536  # the first lines of a file, which show its format
MAX_HEADER_BYTES = 100_000  # comment lines before the samples of a log
MAX_HEADER_LINES = 1000
# Files that come with samples, such as meta.json, have some kilobytes; parsed they take some thirty times their size.
MAX_SMALL_BYTES = 1_000_000
# Models, calibrations and fixes, which are read as a whole: a shipped model has 0.4 MB, a day of fixes 4 MB.
MAX_DESCRIPTION_BYTES = 4 * 1024**2  # JSON
MAX_PLAN_BYTES = 8 * 1024**2  # a floor plan of a mall has 0.15 MB
MAX_WHOLE_BYTES = 64 * 1024**2
MAX_UNPACKED_BYTES = 256 * 1024**2
MAX_FIXES = 24 * 3600 * 2
# A TOML file that describes the columns of a table; its parser takes a second for some megabytes.
MAX_TOML_BYTES = 100_000
MAX_COLUMNS = 1000  # of a table
# Words for a stretch of a walk, at most one a second of a day, each as wide in memory as the longest of them.
MAX_TEXT_ROWS = 24 * 3600
MAX_TABLES = 100  # experiments of phyphox have some ten
MAX_ARRAY_ROWS = 24 * 3600 * 200  # a day at 200 Hz: hdf5 is read into memory at once
HEAD_ROWS = 200  # the first rows of a sensor show when the recording began
# Texts of a file that are kept in the meta data of a recording: how many, and characters of each.
MAX_ANNOTATIONS = 1000
MAX_SENTENCES = 50
MAX_NAME_CHARS = 200
MAX_TEXT_CHARS = 500

# A pause longer than this in a sensor that samples faster is a gap: within it a step can be missed.
GAP_S = 0.3
# A slow sensor (1 Hz GNSS) has a gap only where samples are missing, so where an interval is this many usual ones.
GAP_INTERVALS = 2.5
# Gravity is interpolated to the times of the accelerometer; within this it turns by less than a step's swing.
GRAVITY_GAP_S = 0.3

# Nothing measured is larger; up to here squares and sums of squares stay finite.
LARGEST_VALUE = 1e30
MAX_INT64 = 2**63 - 1
# Differences of whole times up to here fit into an int64; in nanoseconds it is the years 1824 to 2116.
MAX_WHOLE_TIME = 2**62
MAX_ELAPSED_S = 1e9
MAX_EPOCH_S = 253_402_300_799.0  # the last second of the year 9999, where calendars of computers end
HEIGHT_RANGE_M = (0.4, 2.8)

# A window of 0.2 s at the lowest rate below; fewer samples cannot hold a step.
MIN_SAMPLES = 10
# Walking has its step at 2 Hz, so less than 5 Hz cannot show it; no phone delivers more than 2000 Hz. The range spans
# less than a factor of 1000, so at most one of ms, us and ns explains a rate outside it.
RATE_RANGE_HZ = (5.0, 2000.0)
# Median |specific force| of 349 real recordings is 8.6 to 15.5 m/s2 (jogging, phone in the pocket); in g that is 0.9 to
# 1.6. Walking with gravity removed gives about 1 to 4, so the message for small values names both.
SPECIFIC_FORCE_RANGE_MPS2 = (5.0, 25.0)
G_RANGE = (0.8, 1.7)
# Two turns a second as the median; jogging reaches 4.3. The same walk in deg/s gives 20 and more.
MAX_MEDIAN_ANGULAR_RATE_RADPS = 12.0
MAGNETIC_FIELD_RANGE_UT = (20.0, 80.0)  # the Earth's is 22 to 67 uT, steel indoors bends it a little further
PRESSURE_RANGE_HPA = (500.0, 1100.0)  # 5000 m up to a deep valley
QUATERNION_NORM_RANGE = (0.98, 1.02)
# Mean cosine between the specific force, turned into the world by the phone's own attitude, and up. It is 0.9 and more
# in a walk with the right sign, -0.9 with the wrong one; attitudes that were never aligned with gravity lie between.
UP_COSINE_WRONG_SIGN = -0.5
UP_COSINE_DOUBTFUL = 0.5
