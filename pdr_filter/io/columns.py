"""What the columns of a table are, by their names: the words, axes and units of the apps, as data.

`ACCELEROMETER X (m/s\u00b2)`, `accelerometerAccelerationX(G)`, `MPL_Accelerometer.x`, `acc_x[m/s^2]`, `ACCEX` and `gFx`
are all an axis of one quantity. A word of the vocabulary may have anything before it; the longest that fits is taken.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass

from pdr_filter.values import STANDARD_GRAVITY_MPS2

ACCELERATION, LINEAR, GRAVITY = "acceleration", "linear_acceleration", "gravity"
RATE, FIELD = "gyroscope", "magnetometer"
ROTATION = "rotation"  # of some apps the angular rate, of others the orientation
VECTORS = (ACCELERATION, LINEAR, GRAVITY, RATE, FIELD, ROTATION)
SCALARS = ("barometer", "light", "proximity")
LOCATION = ("latitude", "longitude", "altitude", "accuracy")

_WORDS = {
    ACCELERATION: "acceleration accelerometer acc acce accel totalacceleration accelerationwithg gf gforce "
    "specificforce beschleunigung accelerazione accelerometro aceleracion acelerometro",
    LINEAR: "linearacceleration linearaccelerometer lacc linacc linacce linaccel linearacc linearaccel "
    "useracceleration useraccel useracc accelerationwithoutg linearebeschleunigung",
    GRAVITY: "gravity grav gravitation",
    RATE: "gyroscope gyro gyr gyrorotation rotationrate angularvelocity angularrate angularspeed angvel drehrate "
    "gyroskop giroscopio",
    ROTATION: "rotation rot",
    FIELD: "magneticfield magnetometer magnet magn mag mafi magfield magnetfeld",
    "barometer": "pressure barometer baro bar pres druck",
    "light": "illuminance light lux",
    "proximity": "proximity prox",
    "latitude": "latitude lat",
    "longitude": "longitude lon lng",
    "altitude": "altitude height altitudewgs",
    "accuracy": "horizontalaccuracy accuracy",
    # What has axes, too, and is no vector in the phone.
    "orientation": "orientation attitude euler rotationvector quaternion heading compass position velocity speed",
}
QUANTITY_OF = {word: quantity for quantity, words in _WORDS.items() for word in words.split()}
# Letters of the physics books, which stand alone: a word may not end with them.
_LETTERS = {
    **{"a": ACCELERATION, "w": RATE, "g": RATE, "b": FIELD, "m": FIELD},
    **dict.fromkeys(("lineara", "lina", "usera"), LINEAR),  # as in linear_ax
}
_SHORTEST = 3  # letters of a word that may have something before it
# What a unit alone says of a column whose word is in a language that is not known.
OF_UNIT = {
    **dict.fromkeys(("m/s^2", "m/s2"), ACCELERATION),
    **dict.fromkeys(("rad/s", "\u00b0/s", "deg/s"), RATE),
    **{"ut": FIELD, "hpa": "barometer"},
}
_AXIS_ALONE = re.compile(r"[\s_.]([xyz])\s*$", re.IGNORECASE)
_BARE = re.compile(r"([xyz])(?:axis|value)?|values?([xyz])")
_CALIBRATED = re.compile(r"(un)?cal(ibrated)?$|raw$")
_UNIT = re.compile(r"[(\[]([^()\[\]]*)[)\]]\s*$")
# Behind an axis, as in `ax_g` and `gyro_z_dps`.
_UNIT_WORD = re.compile(r"(?<=[xyz])[_ .]+(m?g|m_?p?s_?2|m?dps|deg_?p?s|rad_?p?s|ut)$", re.IGNORECASE)
_UNIT_OF_WORD = {"mps2": "m/s2", "ms2": "m/s2", "degps": "deg/s", "degs": "deg/s", "radps": "rad/s", "rads": "rad/s"}

# Factors to the unit of the stream, by how the apps write units, without spaces and in lower case.
_ACCELERATIONS = {
    **dict.fromkeys(("m/s^2", "m/s2", "m/s/s", "ms^-2"), 1.0),
    **{"g": STANDARD_GRAVITY_MPS2, "mg": 1e-3 * STANDARD_GRAVITY_MPS2},
}
_RATES = {
    "rad/s": 1.0,
    **dict.fromkeys(("deg/s", "\u00b0/s", "dps"), math.pi / 180),
    "mdps": math.pi / 180e3,
}
UNITS: dict[str, dict[str, float]] = {
    **dict.fromkeys((ACCELERATION, LINEAR, GRAVITY), _ACCELERATIONS),
    **dict.fromkeys((RATE, ROTATION), _RATES),
    FIELD: {"ut": 1.0, "mt": 1000.0, "t": 1e6, "gauss": 100.0, "g": 100.0},
    "barometer": {"hpa": 1.0, "mbar": 1.0, "pa": 0.01, "kpa": 10.0},
    "light": {"lux": 1.0, "lx": 1.0},
    "proximity": {"cm": 1.0, "mm": 0.1, "m": 100.0, "i": 1.0},
}
# Cyrillic m, s, rad, and uT as "mkT" and an l
_LATIN = dict(zip(map(ord, "\u043c\u0441\u0440\u0430\u0434\u043a\u0442"), "msradkt", strict=True)) | {0x43B: ""}
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_TIME = re.compile(r"(time|stamp|zeit|elapsed|sincestart|datetime|date|clock|epoch)")
_WHOLE_SECONDS = re.compile(r"(.*?)(secs?|seconds?)", re.IGNORECASE)
_TIME_WORDS = {  # in other languages
    *("tiempo", "temps", "tempo", "tijd", "czas", "aika", "tid", "hora", "heure", "ora", "uhr", "zaman", "waktu"),
    *("\u0432\u0440\u0435\u043c\u044f", "\u6642\u9593", "\u65f6\u95f4", "\u6642\u523b", "\uc2dc\uac04"),
}
_TIME_UNIT_WORDS = {
    "s": r"s|sec|secs|seconds?|sincereboot",
    "ms": r"ms|msec|millis|milliseconds?",
    "us": r"us|usec|micros|microseconds?",
    "ns": r"ns|nsec|nanos|nanoseconds?",
}


@dataclass(frozen=True, slots=True)
class Column:
    """What the name of a column says."""

    place: int
    name: str  # as it is in the table
    quantity: str  # empty of an axis or a number without a word
    axis: str = ""  # x, y, z; empty of a scalar
    unit: str = ""  # empty if the name says none
    stem: str = ""  # its letters without the axis; what the three axes of one sensor share
    preference: int = 1  # 2 of what is called calibrated, 0 of what is called uncalibrated or raw


def normal_unit(unit: str) -> str:
    """A unit as in `UNITS`."""
    unit = unit.lower().replace(" ", "").replace("\u00b2", "^2").replace("\u00b5", "u").replace("\u03bc", "u")
    unit = unit.replace("\u00e2", "")  # what is left of a sign that was decoded wrongly
    return unit.translate(_LATIN).replace("mkt", "ut")


def is_unit(text: str) -> bool:
    """Whether a text is a unit, of a sensor or a time."""
    unit = normal_unit(text)
    return unit in TIME_UNITS or any(unit in units for units in UNITS.values())


def letters(name: str) -> str:
    """The letters of a name, in lower case and without accents."""
    return re.sub(r"[^a-z]", "", unicodedata.normalize("NFKD", name).lower())


def quantity_of_stem(stem: str) -> tuple[str, int]:
    """The quantity of letters that end with a word of the vocabulary, and its preference; "" if none."""
    short = _CALIBRATED.sub("", stem)
    preference = 1 if short == stem else 2 if stem.removeprefix(short) in ("cal", "calibrated") else 0
    if short in _LETTERS:
        return _LETTERS[short], preference
    if short in QUANTITY_OF:
        return QUANTITY_OF[short], preference
    fitting = [word for word in QUANTITY_OF if len(word) >= _SHORTEST and short.endswith(word)]
    return (QUANTITY_OF[max(fitting, key=len)], preference) if fitting else ("", preference)


def quantity_of_file(name: str) -> tuple[str, int]:
    """The quantity that the name of a file or a sheet says anywhere, and its preference; "" if none."""
    found = letters(name)
    words = {letters(word) for word in re.split(r"[^A-Za-z]+", name)}
    fitting = [w for w in QUANTITY_OF if (w in found if len(w) > _SHORTEST else w in words)]
    fitting = [w for w in fitting if w not in ("bar", "g", "rotation", "rot")]
    fitting += [w for w in ("bar",) if w in words]
    preference = 0 if "uncal" in found or "raw" in words else 2 if "calibrated" in found else 1
    return (QUANTITY_OF[max(fitting, key=len)] if fitting else ""), preference


def column_of(place: int, name: str) -> Column:
    """What a name says; see the examples above."""
    unit_found = _UNIT.search(name) or _UNIT_WORD.search(name.rstrip())
    unit = normal_unit(unit_found[1]).replace("_", "") if unit_found else ""
    unit = _UNIT_OF_WORD.get(unit, unit)
    words = name[: unit_found.start()] if unit_found else name
    stem = letters(words)
    if bare := _BARE.fullmatch(stem):
        return Column(place, name, "", bare[1] or bare[2], unit)
    for axis, rest in ((stem[-1:], stem[:-1]), (stem[:1], stem[1:])):  # the axis behind the word, or before it
        if axis in ("x", "y", "z"):
            quantity, preference = quantity_of_stem(rest)
            if quantity == ROTATION and unit:
                quantity = RATE if unit in UNITS[RATE] else ""
            if quantity in VECTORS:
                unit = unit or ("g" if rest in ("gf", "gforce") else "")
                return Column(place, name, quantity, axis, unit, rest, preference)
    quantity, preference = quantity_of_stem(stem)
    axis_found = _AXIS_ALONE.search(words)
    if not quantity and axis_found:  # the chip behind the word, as in accelerometer_lsm6ds3_c.x
        word = words[: axis_found.start()]
        begins = [word[: gap.start()] for gap in re.finditer(r"[^A-Za-z]+", word)]
        known = next((q for begin in reversed(begins) if (q := quantity_of_stem(letters(begin))[0])), "")
        if known in VECTORS:
            return Column(place, name, known, axis_found[1].lower(), unit, letters(word), 0)
    if not quantity and axis_found and OF_UNIT.get(unit) in VECTORS:
        word = words[: axis_found.start()].lower()
        return Column(place, name, OF_UNIT[unit], axis_found[1].lower(), unit, word)
    return Column(place, name, "" if quantity in VECTORS else quantity, "", unit, stem, preference)


def is_time(name: str) -> bool:
    """Whether a name is one of a time."""
    bare = _UNIT.sub("", name)
    stem = letters(bare)
    is_word = not _TIME_WORDS.isdisjoint(bare.lower().split())
    is_unit = any(re.fullmatch(pattern, stem) for pattern in _TIME_UNIT_WORDS.values())
    letter, _, unit = bare.strip().lower().partition("_")  # as in t_ms
    is_letter = stem in ("t", "ts") or (letter in ("t", "ts") and unit in TIME_UNITS)
    return is_word or is_unit or is_letter or _TIME.search(stem) is not None


def nanoseconds_of(fields: Sequence[str], place: int) -> int | None:
    """The column with the nanoseconds of a column of whole seconds, as ROS has them: stamp.secs and stamp.nsecs."""
    found = _WHOLE_SECONDS.fullmatch(fields[place])
    names = [] if found is None else [f"{found[1]}{nano}{found[2]}".lower() for nano in ("n", "nano")]
    return next((i for i, name in enumerate(fields) if name.lower() in names), None)


def has_time_unit(name: str) -> bool:
    """Whether a name ends with a unit of time in brackets: a time in a language that is not known."""
    found = _UNIT.search(name)
    return found is not None and normal_unit(found[1]) in TIME_UNITS


def time_unit_of(name: str) -> str:
    """The unit that the name of a time says; empty if none."""
    found = _UNIT.search(name)
    words = [found[1].strip()] if found else re.split(r"[^A-Za-z\u00b5\u03bc]+", name)
    words = [normal_unit(word) for word in words]
    for unit, pattern in _TIME_UNIT_WORDS.items():
        if any(re.fullmatch(pattern, word) for word in words if word):
            return unit
    return ""
