"""Quantity, axis and unit of a column by its name: the vocabulary of the apps, as data.

`ACCELEROMETER X (m/s\u00b2)`, `accelerometerAccelerationX(G)`, `MPL_Accelerometer.x`, `acc_x[m/s^2]`, `ACCEX` and `gFx`
are all an axis of one quantity. Other words may stand before one of the vocabulary; the longest that fits is taken.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

from pdr_filter.values import STANDARD_GRAVITY_MPS2

ACCELERATION, LINEAR, GRAVITY = "acceleration", "linear_acceleration", "gravity"
RATE, FIELD = "gyroscope", "magnetometer"
ROTATION = "rotation"  # the angular rate in some apps, the orientation in others
VECTORS = (ACCELERATION, LINEAR, GRAVITY, RATE, FIELD, ROTATION)
ANGLES = "angles"  # roll, pitch and yaw of CoreMotion
SCALARS = ("barometer", "light", "proximity")
LOCATION = ("latitude", "longitude", "altitude", "accuracy")
PHONE_HEADING, PHONE_STEPS = "phone_heading", "phone_step_count"  # computed by the phone itself

_WORDS = {
    ACCELERATION: "acceleration accelerometer acc acce accel totalacceleration gf gforce "
    "specificforce beschleunigung accelerazione accelerometro accelerometre aceleracion aceleracao acelerometro",
    LINEAR: "linearacceleration linearaccelerometer lacc linacc linacce linaccel linearacc linearaccel "
    "useracceleration useraccel useracc linearebeschleunigung",
    GRAVITY: "gravity grav gravitation",
    RATE: "gyroscope gyro gyr gyrorotation rotationrate rotrate turnrate angularvelocity angularrate angularspeed "
    "angvel omega drehrate gyroskop giroscopio",
    ROTATION: "rotation rot",
    FIELD: "magneticfield magnetic magnetometer magnet magn mag mafi magfield magnetfeld",
    "barometer": "pressure barometer baro bar pres druck",
    "light": "illuminance light lux",
    "proximity": "proximity prox",
    "latitude": "latitude lat gpslat latitud latitudine breitengrad breite breedtegraad",
    "longitude": "longitude lon gpslon gpslng lng long longitud longitudine langengrad lange lengtegraad",
    "altitude": "altitude alt height elevation ele altitudewgs altitud altitudine hohe hoogte",
    # Quantities with axes that are not vectors in the frame of the phone.
    "orientation": "orientation attitude euler rotationvector quaternion heading compass position velocity speed",
}
QUANTITY_OF = {word: quantity for quantity, words in _WORDS.items() for word in words.split()}
# These words are known alone, not at the end of a longer name: heart_rate_x is not an angular rate.
_LETTERS = {
    **{"a": ACCELERATION, "w": RATE, "g": RATE, "b": FIELD, "m": FIELD, "rate": RATE, "rates": RATE},
    **{"ac": ACCELERATION, "gy": RATE},  # as in AcX and GyX
    **dict.fromkeys(("lineara", "lina", "usera"), LINEAR),  # as in linear_ax
}
# A word may stand anywhere in a name. Only these are also recognised at the end of a longer word, such as `wristaccx`:
# "lacc" is at the end of "totalacc", and "light" at that of "flight".
_GLUED = [
    word for word, quantity in QUANTITY_OF.items() if len(word) >= (3 if quantity in VECTORS else 6) and word != "lacc"
]
# These words are in the names of files that hold no such sensor: long_walk, speed_test, heading_north.
_OF_FILES = {
    word: quantity
    for word, quantity in QUANTITY_OF.items()
    if quantity not in LOCATION and word not in ("speed", "heading", "rotation", "rot")
}
_BEHIND = {"data", "raw", "log", "logs", "sensor", "samples", "values", "cal", "uncal"}  # as in gyrodata
_LONG = 8  # letters of a word that no other one contains by chance
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")
# Web browsers name the axes of the angular rate so (W3C, "Device Orientation and Motion"; w3c/deviceorientation#44).
_GREEK_AXES = {"alpha": "x", "beta": "y", "gamma": "z"}
_WITH_GRAVITY = re.compile(
    r"((acc|acel|beschl)[a-z]*(incl|including|with|plus|and|mit|con|com|avec)|including)g(rav[a-z]*)?$"
)
_WITHOUT_GRAVITY = re.compile(
    r"(acc|acel|beschl)[a-z]*((excl|excluding|without|minus|no|ohne|sin|sans|senza|sem)g(rav[a-z]*)?|linea(r|l|re|ire))$"
)
_ACCURACY = re.compile(
    r"accurac(y|ies)|accuratezza|genauigkeit|nauwkeurigheid|precis(ion|ione|ao)|exactitude?|uncertainty"
    r"|dokadnosc|noggrannhet|nyaktighe[dt]|tarkkuus|dogruluk"  # words with letters that have no plain form
    r"|\u7cbe\u5ea6|\uc815\ud655\ub3c4|\u0442\u043e\u0447\u043d\u043e\u0441\u0442\u044c"
)
_HORIZONTAL_ALONE = re.compile(
    r"(gps|gnss|loc|location|pos|position)?((h|hor|horiz|horizontal)acc|acch)(m|met(er|re)s)?|eph"
)
_HORIZONTAL = re.compile(r"hori|orizz|\u6c34\u5e73|\uc218\ud3c9|\u0433\u043e\u0440\u0438\u0437")
# An accuracy is of the horizontal position unless its name has one of these words or parts.
_OF_OTHERS = re.compile(
    r"vert|altitu|elevation|h(oe|o)he|hoogte|speed|veloc|vitesse|geschw|snelheid|bearing|course|heading|dire[cz]|richtung"
    r"|rumb?o|k(oe|u)rs|peilung|yaw|gier|compass|orient|rotation|magn|gyro|ac?cel|time|clock|status|dop|\u5782\u76f4|\uc218\uc9c1|\u0432\u0435\u0440\u0442"
    r"|\u901f|\uc18d\ub3c4|\u0441\u043a\u043e\u0440"
    r"|\u65b9|\u9ad8|\ubc29\ud5a5|\uace0\ub3c4|\u0432\u044b\u0441|\u043d\u0430\u043f\u0440|\u043a\u0443\u0440\u0441"
)
_OF_OTHERS_WORDS = {"v", "s", "alt", "ele", "vel", "head", "cap", "dir", "yaw", "acc", "mag", "sensor"}
# Codes of android.hardware.Sensor and letters, which loggers write in place of names.
SENSOR_CODES = {
    **{"1": ACCELERATION, "2": FIELD, "4": RATE, "5": "light", "6": "pressure", "8": "proximity", "9": GRAVITY},
    **{"10": LINEAR, "14": "magnetometer raw", "16": "gyroscope raw", "35": "accelerometer raw"},
    **{"a": ACCELERATION, "g": RATE, "m": FIELD, "A": ACCELERATION, "G": RATE, "M": FIELD},
}
# Quantity by unit alone, for columns named in an unknown language.
OF_UNIT = {
    **dict.fromkeys(("m/s^2", "m/s2"), ACCELERATION),
    **dict.fromkeys(("rad/s", "\u00b0/s", "deg/s"), RATE),
    **{"ut": FIELD, "hpa": "barometer"},
}
_AXIS_ALONE = re.compile(r"[\s_.]([xyz])\s*$", re.IGNORECASE)
_AXES = ("x", "y", "z")
_BARE = re.compile(r"([xyz])(?:axis|value)?|(?:value|measurement)s?([xyz])")
_CALIBRATED = re.compile(r"(un)?cal(ibrated)?$|raw$")
_UNIT = re.compile(r"[(\[]([^()\[\]]*)[)\]]\s*$")
# Behind an axis, as in `ax_g` and `gyro_z_dps`.
_UNIT_WORD = re.compile(r"(?<=[xyz])[_ .]+(m?g|m_?p?s_?2|m?dps|deg_?p?s|rad_?p?s|ut)$", re.IGNORECASE)
_UNIT_OF_WORD = {"mps2": "m/s2", "ms2": "m/s2", "degps": "deg/s", "degs": "deg/s", "radps": "rad/s", "rads": "rad/s"}

# Factors to the unit of the stream, by how the apps write units, without spaces and in lower case.
_ACCELERATIONS = {
    **dict.fromkeys(("m/s^2", "m/s2", "m/s/s"), 1.0),
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
    ANGLES: {"rad": 1.0, "radians": 1.0, "deg": math.pi / 180, "\u00b0": math.pi / 180},
    FIELD: {"ut": 1.0, "mt": 1000.0, "t": 1e6, "gauss": 100.0, "g": 100.0},
    "barometer": {"hpa": 1.0, "mbar": 1.0, "pa": 0.01, "kpa": 10.0},
    "light": {"lux": 1.0, "lx": 1.0},
    "proximity": {"cm": 1.0, "mm": 0.1, "m": 100.0, "i": 1.0},
    PHONE_HEADING: {"deg": math.pi / 180, "\u00b0": math.pi / 180, "rad": 1.0},
    PHONE_STEPS: {"steps": 1.0},
}
# Cyrillic m, s, rad, and uT as "mkT" and an l
_LATIN = dict(zip(map(ord, "\u043c\u0441\u0440\u0430\u0434\u043a\u0442"), "msradkt", strict=True)) | {0x43B: ""}
# How people spell units, in the order of their replacement.
_SPELLINGS = (
    (r"^\s*in\s+|'s?\s*$|[\s\u00b7\u22c5*]", ""),
    (r"met(er|re)s?", "m"),
    (r"degrees?", "deg"),
    (r"radians?", "rad"),
    (r"squared", "^2"),
    (r"\^-\^", "^-"),
    (r"seconds?|secs?", "s"),
    (r"per", "/"),
    (r"microteslas?", "ut"),
    (r"(?<=[a-z])s\^*-2$", "/s^2"),
    (r"(?<=[a-z])s\^*-1$", "/s"),
)
TIME_UNITS = {
    **{"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "100ns": 1e-7},
    **{"min": 60.0, "h": 3600.0, "days": 86_400.0},
}
# Unix time from 2004 to 2039. Nanoseconds since a phone was started 20 minutes ago are as large as milliseconds of
# that, but would then come less often than any sensor.
_EPOCH_S = (1.1e9, 2.2e9)
# Clocks of Windows count 100 ns since 1601 (FILETIME) or since the year 1 (.NET), so many seconds before 1970. Days are
# counted since 1970, 1899 (spreadsheets), the year 0 (MATLAB) or 1858 (modified Julian date). No clock counts minutes.
_ZEROS_S: dict[str, tuple[float, ...]] = {
    "100ns": (0.0, 11_644_473_600.0, 62_135_596_800.0),
    "days": tuple(86_400.0 * days for days in (0, 25_569, 719_529, 40_587)),
    **dict.fromkeys(("min", "h"), ()),
}
_TIME = re.compile(r"(time|stamp|zeit|elapsed|sincestart|datetime|date|clock|epoch)")
_INTERVAL = re.compile(r"^dt|dt$|delta|interval|diff|period")
_RATE = re.compile(
    r"(data|sensor)?sampl(es?|ing)?(rate|freq|frequency|persecond)(hz)?|(data|sensor|update)?(rate|freq|frequency)hz"
    r"|frequency|fs|hz|odr"
)
_PERIOD = re.compile(
    r"(data|sensor|update|log|logging|record|recording)?(sampl(es?|ing))?"
    r"(time)?(dt|deltat?|interval|period|spacing)(time)?(s|sec|seconds?|ms|millis|milliseconds?|us|ns)?"
)
_PERIODS_S = (1e-3, 0.2)  # sampling periods of phones (1 kHz) to slow loggers (5 Hz)
_WHOLE_SECONDS = re.compile(r"(.*?)(secs?|seconds?)", re.IGNORECASE)
_STEP_COUNTS = re.compile(r"(pedometer)?((numberof|n)steps?|steps|steps?(n|count(er)?))|schritte")
_HEADINGS = re.compile(r"(location)?(true|magnetic)?(heading|compass|azimuth)((deg)(rees)?|(rad)(ians)?)?")
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
# These words are units of a time only in brackets or behind a plain word for time: a column `minute` is a part of a
# date, and `time_of_day` has seconds.
_LONG_UNIT_WORDS = {"min": r"min|mins|minutes?", "h": r"h|hr|hrs|hours?", "days": r"d|days?"}
_LONG_UNIT = re.compile(
    r"(?:t|ts|timestamp|(?:elapsed)?[ _]?(?:time)?[ _]?(?:elapsed)?)[ _]?(min|mins|minutes|h|hr|hrs|hours|days)",
    re.IGNORECASE,
)


@dataclass(frozen=True, slots=True)
class Column:
    """Quantity, axis and unit in the name of a column."""

    place: int
    name: str  # as written in the table
    quantity: str  # empty for a bare axis or an unknown word
    axis: str = ""  # x, y or z; empty for a scalar
    unit: str = ""  # empty if the name says none
    stem: str = ""  # its letters without the axis; what the three axes of one sensor share
    preference: int = 1  # 2 if called calibrated, 0 if called uncalibrated or raw


def normal_unit(unit: str) -> str:
    """Return the name of a unit in the spelling of the keys of `UNITS`, in lower case and without spaces.

    Examples
    --------
    >>> [normal_unit(unit) for unit in ("m s^-2", "in G's", "rad s^-1", "degrees per second")]
    ['m/s^2', 'g', 'rad/s', 'deg/s']
    """
    unit = unit.lower().replace("\u00b2", "^2").replace("\u207b", "^-").replace("\u00b9", "1").replace("\u2212", "-")
    unit = unit.replace("\u00b5", "u").replace("\u03bc", "u")
    unit = unit.replace("\u00e2", "")  # remains of a degree sign decoded in another code page
    unit = unit.translate(_LATIN).replace("mkt", "ut")
    for spelled, short in _SPELLINGS:
        unit = re.sub(spelled, short, unit)
    return unit


def is_unit(text: str) -> bool:
    """Return True if a text is a unit of a sensor or of time."""
    unit = normal_unit(text)
    return unit in TIME_UNITS or any(unit in units for units in UNITS.values())


def letters(name: str) -> str:
    """Return the letters of a name in lower case and without accents."""
    return re.sub(r"[^a-z]", "", unicodedata.normalize("NFKD", name).lower())


def words_of(name: str) -> list[str]:
    """Return the words of a name in lower case, without accents, separated by other characters or by `camelCase`."""
    plain = "".join(c for c in unicodedata.normalize("NFKD", name) if not unicodedata.combining(c))
    return [word.lower() for word in _WORD.findall(plain)]


def quantity_of_words(words: Sequence[str]) -> tuple[str, int]:
    """Return the quantity that the last words of a column name state, and the preference of the column.

    The quantity is "" if the words name none. The preference is 2 for calibrated values, 0 for raw or uncalibrated
    values, and 1 for others. Of several columns of a quantity, that with the largest preference is used.

    Examples
    --------
    >>> quantity_of_words(["total", "acc"]), quantity_of_words(["lacc"])
    (('acceleration', 1), ('linear_acceleration', 1))
    """
    stem = "".join(words)
    short = _CALIBRATED.sub("", stem)
    preference = 1 if short == stem else 2 if stem.removeprefix(short) in ("cal", "calibrated") else 0
    if short in _LETTERS:
        return _LETTERS[short], preference
    if of_gravity := _by_gravity(short):
        return of_gravity, preference
    ends = ["".join(words[i:])[: len(short) - len(stem) or None] for i in range(len(words))]
    known = next((QUANTITY_OF[end] for end in ends if end in QUANTITY_OF and len(end) > 1), "")
    fitting = [word for word in _GLUED if short.endswith(word)]
    if not known and not fitting and short.endswith("g"):  # accG: in g, which its size must show
        of_g = quantity_of_words([short[:-1]])[0]
        return of_g if of_g in (ACCELERATION, LINEAR) else "", preference
    return known or (QUANTITY_OF[max(fitting, key=len)] if fitting else ""), preference


@lru_cache(maxsize=256)
def quantity_of_file(name: str) -> tuple[str, int]:
    """Return the quantity that the name of a file or sheet contains, or "", and the preference of the file.

    The preference is 2 for calibrated values, 0 for raw or uncalibrated ones, and 1 for others.
    """
    words = words_of(name)
    parts = {"".join(words[i:j]) for i in range(len(words)) for j in range(i + 1, min(i + 4, len(words)) + 1)}
    fitting = [word for word in _OF_FILES if word in parts or any(_is_within(longer, word) for longer in words)]
    found = "".join(words)
    preference = 0 if "uncal" in found or "raw" in words else 2 if "calibrated" in found else 1
    return _by_gravity(found) or (QUANTITY_OF[max(fitting, key=len)] if fitting else ""), preference


def _is_within(longer: str, word: str) -> bool:
    """Return True if `longer`, one word of a file name, is the known `word` joined to something else.

    At its start the word must be followed by one such as data or raw, or by another known word (gyrodata). At the end
    it must have 4 letters (wristaccel), elsewhere `_LONG`: a longer word may contain shorter ones by chance.
    """
    before, found, behind = longer.partition(word)
    is_glued = bool(found) and word in _GLUED and QUANTITY_OF[word] != "orientation"
    if not before and not (is_glued and len(word) >= _LONG):
        return behind in _BEHIND or behind in _OF_FILES
    return is_glued and len(word) >= (_LONG if behind else 4)


def _by_gravity(stem: str) -> str:
    """Return the quantity of an acceleration whose name states that it is with or without gravity, or ""."""
    return LINEAR if _WITHOUT_GRAVITY.search(stem) else ACCELERATION if _WITH_GRAVITY.search(stem) else ""


def trial_of(name: str) -> str:
    """Return the name of a file without suffix and without the words of its sensor: `walk1` for `walk1_acc.csv`."""
    stem = re.sub(r"\.\w+$", "", name.rpartition("/")[2])
    words = [(word.start(), word.end(), word[0].lower()) for word in _WORD.finditer(stem)]
    of_sensor = {
        place
        for i in range(len(words))
        for j in range(i + 1, min(i + 3, len(words)) + 1)
        if "".join(word for _, _, word in words[i:j]) in (*QUANTITY_OF, "sensor", "data", "uncalibrated", "calibrated")
        for place in range(words[i][0], words[j - 1][1])
    }
    left = "".join(" " if place in of_sensor else letter for place, letter in enumerate(stem))
    return re.sub(r"[\s_.()-]+", "_", left).strip("_")


def _accuracy(name: str, unit: str) -> int | None:
    """Return how surely a column holds the horizontal accuracy of a location. None for a name without accuracy.

    The score is 3 if the name says horizontal, 2 without a direction, and 0 for another one, as of a height or speed.
    """
    words = words_of(name)
    stem = "".join(words)
    # `words_of` drops letters of other scripts.
    shown = stem + "".join(c for c in name.lower() if not c.isascii())
    if _HORIZONTAL_ALONE.fullmatch(stem):
        return 3
    if not (found := _ACCURACY.search(shown)):
        return None
    rest = shown[: found.start()] + " " + shown[found.end() :]
    if unit not in ("", "m") or _OF_OTHERS.search(rest) or not _OF_OTHERS_WORDS.isdisjoint([*words, rest.strip()]):
        return 0
    return 3 if _HORIZONTAL.search(rest) or "h" in words or "hor" in words else 2


@lru_cache(maxsize=256)  # detection and reading ask for the same names
def column_of(place: int, name: str) -> Column:
    """Return the quantity, axis and unit that a column name states. `place` is the index of the column."""
    unit_found = _UNIT.search(name) or _UNIT_WORD.search(name.rstrip())
    unit = normal_unit(unit_found[1]).replace("_", "") if unit_found else ""
    unit = _UNIT_OF_WORD.get(unit, unit)
    bare = name[: unit_found.start()] if unit_found else name
    words = words_of(bare)
    stem = "".join(words)
    if alone := _BARE.fullmatch(stem):
        return Column(place, name, "", alone[1] or alone[2], unit)
    if angle := re.fullmatch(r"attitude(roll|pitch|yaw)(radians)?", stem):
        return Column(place, name, ANGLES, angle[1], "rad" if angle[2] else unit, "attitude")
    if (accuracy := _accuracy(bare, unit)) is not None:
        return Column(place, name, "accuracy" if accuracy else "", "", unit, stem, accuracy)
    for axis, rest in _axes_of(words):
        quantity, preference = quantity_of_words(rest)
        if quantity == ROTATION and unit:
            quantity = RATE if unit in UNITS[RATE] else ""
        if quantity in VECTORS and (len(axis) == 1 or quantity == RATE):
            unit = unit or ("g" if "".join(rest) in ("gf", "gforce") else "deg/s" if axis in _GREEK_AXES else "")
            return Column(place, name, quantity, _GREEK_AXES.get(axis, axis), unit, "".join(rest), preference)
    quantity, preference = quantity_of_words(words)
    if not quantity and words[-1:] in (["deg"], ["degrees"], ["m"]):  # latitude_deg
        shorter, _ = quantity_of_words(words[:-1])
        quantity, unit = (shorter, normal_unit(words[-1])) if shorter in LOCATION else ("", unit)
    if quantity in ("latitude", "longitude") and unit == "m":  # metres are coordinates of a local frame
        quantity = ""
    axis_found = _AXIS_ALONE.search(bare)
    if not quantity and axis_found:  # the chip behind the word, as in accelerometer_lsm6ds3_c.x
        word = bare[: axis_found.start()]
        begins = [word[: gap.start()] for gap in re.finditer(r"[^A-Za-z]+", word)]
        known = next((q for begin in reversed(begins) if (q := quantity_of_words(words_of(begin))[0])), "")
        if known in VECTORS and not quantity_of_words(words_of(word))[0]:  # a rotation vector is not a rotation
            return Column(place, name, known, axis_found[1].lower(), unit, letters(word), 0)
    if not quantity and axis_found and OF_UNIT.get(unit) in VECTORS:
        word = bare[: axis_found.start()].lower()
        return Column(place, name, OF_UNIT[unit], axis_found[1].lower(), unit, word)
    return Column(place, name, "" if quantity in VECTORS else quantity, "", unit, stem, preference)


def _axes_of(words: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    """Yield each axis that the words of a column name may state, with the remaining words.

    It is sought at the end of the last word (accx, or alpha to gamma), and then at the start of the first word (xacc).
    """
    if not words:
        return
    first, last = words[0], words[-1]
    if greek := next((axis for axis in _GREEK_AXES if last.endswith(axis)), ""):
        yield greek, [*words[:-1], last.removesuffix(greek)]
    if last[-1] in _AXES:
        yield last[-1], [*words[:-1], last[:-1]]
    if first[0] in _AXES:
        yield first[0], [first[1:], *words[1:]]


def since_1970(ticks: float, unit: str) -> float | None:
    """Return the Unix time in s of a time in ticks of a unit, or None if no clock shows it between 2004 and 2039."""
    low, high = _EPOCH_S
    times_s = (ticks * TIME_UNITS[unit] - zero_s for zero_s in _ZEROS_S.get(unit, (0.0,)))
    return next((time_s for time_s in times_s if low < time_s < high), None)


def is_step_count(name: str) -> bool:
    """Return True if a column has the name of the phone's own step counter."""
    return _STEP_COUNTS.fullmatch(letters(name)) is not None


def is_heading(name: str) -> bool:
    """Return True if a column has the name of the phone's own heading."""
    unit = _UNIT.search(name)
    is_angle = unit is None or normal_unit(unit[1]) in UNITS[PHONE_HEADING]
    return is_angle and _HEADINGS.fullmatch(letters(_UNIT.sub("", name))) is not None


def heading_unit(name: str) -> str:
    """Return the unit that the name of a heading states in brackets or at its end, or an empty string."""
    stated, at_end = _UNIT.search(name), _HEADINGS.fullmatch(letters(name))
    return normal_unit(stated[1]) if stated else (at_end[5] or at_end[7] or "") if at_end else ""


def bias_of(name: str) -> tuple[str, str] | None:
    """Return quantity and axis of a column with the bias of an uncalibrated sensor, or None for another column.

    Examples
    --------
    >>> bias_of("gyro_bias_x"), bias_of("BiasY"), bias_of("gyro_x")
    (('gyroscope', 'x'), ('', 'y'), None)
    """
    for axis, rest in _axes_of(words_of(_UNIT.sub("", name))):
        of_sensor = re.sub(r"(bias|drift)$", "", "".join(rest))
        if axis in _AXES and of_sensor != "".join(rest):
            return quantity_of_words([of_sensor])[0] if of_sensor else "", axis
    return None


@lru_cache(maxsize=256)
def is_time(name: str) -> bool:
    """Return True if a column has the name of a time."""
    bare = _UNIT.sub("", name)
    stem = letters(bare)
    is_word = not _TIME_WORDS.isdisjoint(bare.lower().split())
    is_unit = any(re.fullmatch(pattern, stem) for pattern in _TIME_UNIT_WORDS.values())
    letter, _, unit = bare.strip().lower().partition("_")  # as in t_ms
    is_letter = stem in ("t", "ts", "dt") or (letter in ("t", "ts") and unit in TIME_UNITS)
    return is_word or is_unit or is_letter or _TIME.search(stem) is not None


def is_interval(name: str) -> bool:
    """Return True if the name of a column of times is that of the times between samples."""
    return _INTERVAL.search(letters(_UNIT.sub("", name))) is not None


@lru_cache(maxsize=256)
def states_period(name: str) -> bool:
    """Return True if a number of this name may be a sampling rate or interval."""
    stem = letters(_UNIT.sub("", name))
    return any(pattern.fullmatch(stem) for pattern in (_PERIOD, _RATE))


def period_of(name: str, value: float) -> float:
    """Return the sampling interval in s that a number states by its name, as a rate in Hz or an interval, or zero.

    Examples
    --------
    >>> period_of("dt", 0.02), period_of("interval_ms", 20), period_of("sampleRate", 50.0), period_of("period", 7.0)
    (0.02, 0.02, 0.02, 0.007)
    """
    low, high = _PERIODS_S
    if not value > 0 or not states_period(name):
        return 0.0
    if not is_interval(name):
        found = [1 / value]
    else:
        unit = time_unit_of(name)
        found = [value * TIME_UNITS[each] for each in ([unit] if unit else ("s", "ms", "us", "ns"))]
    return next((period_s for period_s in found if low <= period_s <= high), 0.0)


def column_of_nanoseconds(fields: Sequence[str], place: int) -> int | None:
    """Return the index of the column of nanoseconds that belongs to a column of whole seconds, or None.

    ROS writes a time as stamp.secs and stamp.nsecs.
    """
    found = _WHOLE_SECONDS.fullmatch(fields[place])
    names = [] if found is None else [f"{found[1]}{nano}{found[2]}".lower() for nano in ("n", "nano")]
    return next((i for i, name in enumerate(fields) if name.lower() in names), None)


def has_time_unit(name: str) -> bool:
    """Return True if a name ends with a unit of time in brackets, which shows a time in any language."""
    found = _UNIT.search(name)
    return found is not None and normal_unit(found[1]) in TIME_UNITS


def time_unit_of(name: str) -> str:
    """Return the unit that the name of a column of times states, or an empty string."""
    stated = _UNIT.search(name) or _LONG_UNIT.fullmatch(name.strip())
    words = [stated[1].strip()] if stated else [*re.split(r"[^A-Za-z\u00b5\u03bc]+", name), *words_of(name)[-1:]]
    words = [normal_unit(word) for word in words]
    for unit, pattern in (_TIME_UNIT_WORDS | (_LONG_UNIT_WORDS if stated else {})).items():
        if any(re.fullmatch(pattern, word) for word in words if word):
            return unit
    return ""
