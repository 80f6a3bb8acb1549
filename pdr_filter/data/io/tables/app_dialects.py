"""Units, signs and recognition patterns of the apps whose tables are read by the names of their columns, as data.

The layouts come from files of users and from the documents of the apps. An app that has another sign on iOS than on
Android is read with Android's sign and a note, unless the platform is known.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import PurePosixPath

from pdr_filter.data.io.column_names import ACCELERATION, FIELD, GRAVITY, LINEAR, RATE
from pdr_filter.data.io.files.archive import Members
from pdr_filter.data.io.text_table import text_rows
from pdr_filter.values import limits
from pdr_filter.values.safe_files import beside, read_small

_SI: Mapping[str, str] = {ACCELERATION: "m/s2", LINEAR: "m/s2", GRAVITY: "m/s2", RATE: "rad/s", FIELD: "ut"}
_METADATA = re.compile(r"(?i)(meta|device)[\w ]*\.(csv|json|txt)")
_STANDARDISED = re.compile(r"(?i)standardisation\W+(true|1)\b")  # Sensor Logger writes Android's signs on both then
_PLATFORM = re.compile(
    r"(?i)\b(?:platform|os|system|device(?:[ _]?(?:name|model|type))?|model)\b\W{1,5}(ios|ip(?:hone|ad)|android)"
)


@dataclass(frozen=True, slots=True)
class Dialect:
    """How to recognise the tables of an app, and what their headers leave open."""

    app: str  # empty if unknown
    shows: str  # regular expression, looked for in the lines above the table, its header and the names of the files
    instead: str = "the accelerometer with gravity"  # what to record where acceleration lacks gravity
    units: Mapping[str, str] = field(default_factory=lambda: _SI)  # where the header says none
    sign: int | None = 1  # of acceleration and gravity; None if it is Android's there and another on iOS
    period_ms: str = ""  # regular expression of the time between rows, for tables without a time
    usual_period_ms: float = 0.0  # of tables without a time that do not say it

    def period_of(self, about: str) -> float:
        """Return the time between rows in ms, from the lines above a table or as usual for the app; 0 if unknown."""
        found = re.search(self.period_ms, about) if self.period_ms else None
        period_ms = float(found[1]) if found else 0.0
        return period_ms if 0.1 < period_ms < 1e6 else self.usual_period_ms


DIALECTS = (
    Dialect(  # in any language
        "phyphox",
        r"(?m:^[^(),]+ \(s\),.*\b[xyz] \((m/s(\^2|\u00b2)|g)\))|(?m:^(.*/)?meta/device\.csv$)",
        "'Acceleration with g' in phyphox",
    ),
    Dialect(
        "Physics Toolbox",
        r"\bgFx\b|(?m:^time[,;\t]\s*ax\b.*\baT\b)",
        "G-Force (gFx, gFy, gFz) in Physics Toolbox",
        sign=None,
    ),
    Dialect(
        "AndroSensor", r"ACCELEROMETER X \(m/s|\bACCEX\b|LINEAR ACCELERATION X \(m/s", "ACCELEROMETER in AndroSensor"
    ),
    Dialect(
        "HyperIMU",
        r"HyperIMU",
        "Accelerometer in HyperIMU",
        period_ms=r"Sampling ?(?:Time|Rate):\s*(\d+(?:\.\d+)?)\s*ms",
    ),
    Dialect(
        "SensorLog",
        r"accelerometerAcceleration|motionUserAcceleration|accelerometerTimestamp_since|\bloggingTime\b",
        "Accelerometer in SensorLog",
        units={**_SI, ACCELERATION: "g", LINEAR: "g", GRAVITY: "g"},
        sign=-1,
    ),
    Dialect(  # Apple's CoreMotion, exported by any app
        "CoreMotion",
        r"\buserAcceleration[._ ]?x\b",
        "gravity beside userAcceleration",
        units={**_SI, ACCELERATION: "g", LINEAR: "g", GRAVITY: "g"},
        sign=-1,
        usual_period_ms=20.0,  # MotionSense (github.com/mmalekzadeh/motion-sense) has no times
    ),
    Dialect(  # DeviceMotionEvent, also of Expo and Cordova
        "a web browser",
        r"accelerationIncludingGravity|\brotationRate[._ ]?(alpha|beta|gamma)\b",
        "accelerationIncludingGravity",
        sign=None,
    ),
    Dialect(
        "MATLAB Mobile",
        r"(Acceleration|AngularVelocity|MagneticField)_?Timestamp|MATLAB Mobile",
        "Acceleration in MATLAB Mobile",
    ),
    Dialect(
        "Sensor Logger",
        r"\btime,seconds_elapsed\b",
        "TotalAcceleration, or Gravity beside Accelerometer, in Sensor Logger",
        sign=None,
    ),
    Dialect("an Android logger", r"\belapsedRealtime(Nanos|Millis)\b", units={}),
    Dialect("senslogs", r"\brecord\.properties\b", "accelerometer.txt in senslogs"),
)


# Dialect of a table whose app is unknown: only its header states units and signs.
UNKNOWN_APP = Dialect("", "", units={}, sign=None)


def dialect_of(text: str) -> Dialect:
    """Return the app that wrote a table, by the lines above it, its header and the names of the files."""
    return next((dialect for dialect in DIALECTS if re.search(dialect.shows, text, re.IGNORECASE)), UNKNOWN_APP)


def said_platform(members: Members, about: str = "") -> str:
    """Return the platform (ios or android) that the metadata files or the lines above a table name, or "".

    It decides the sign of the acceleration: iOS counts as android if the app says that it has standardised the signs.
    """
    names = [name for name in members.names if _METADATA.fullmatch(PurePosixPath(name).name)]
    contents = [(members.small(name), name) for name in names if members.is_container]
    for path in () if members.is_container or members.inside else sorted(members.path.parent.glob("[MmDd]e[tv][ai]*")):
        if _METADATA.fullmatch(path.name) and path.is_file():
            contents.append((read_small(beside(members.path, path.name), limits.MAX_SMALL_BYTES), path.name))
    for content, name in contents:
        rows = text_rows(content, name) if name.lower().endswith(".csv") else []
        about += "\n" + content.decode("utf-8", "replace")
        about += "".join(f"\n{key}: {value}" for key, value in zip(*rows[:2], strict=False)) if len(rows) > 1 else ""
    found = _PLATFORM.search(about)
    if found is None:
        return ""
    return "android" if found[1].lower() == "android" or _STANDARDISED.search(about) else "ios"
