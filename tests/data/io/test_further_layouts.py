"""Names of columns and files in further layouts, twenty or more of each kind, and the quantity of each."""

from __future__ import annotations

from pathlib import Path

import pytest
from app_files import a_walk, assert_same_streams, axes, on_one_clock, refusal, table_text, write_text

from pdr_filter.data.io.column_names import column_of, quantity_of_file
from pdr_filter.data.io.formats import read
from pdr_filter.data.io.tables.any_table import read_any_table
from pdr_filter.values import STANDARD_GRAVITY_MPS2

HORIZONTAL = """
horizontal_accuracy_m; locationHorizontalAccuracy(m); gpsHorizontalAccuracy; coords.accuracy; location.coords.accuracy
LOCATION Accuracy ( m)
Horizontale Genauigkeit (m); Précision horizontale (m); precisión (m); Precisão horizontal (m)
Precisione orizzontale (m); Nauwkeurigheid (m); 水平精度 (m); 精度; 정확도 (m); Точность (м); h_acc; hAcc_m; gps_hacc
doğruluk; acc_h; accH_m; gps_acc_h
horizontalAccuracy; horizontal_accuracy_m; HORIZONTALACCURACY; hacc; hAcc; horAccuracy; accuracy; positionAccuracy
Horizontale Genauigkeit (m); Precisión horizontal (m); Accuratezza orizzontale (m); Horizontale nauwkeurigheid (m)
수평 정확도; Горизонтальная точность
eph; HorizontalAccuracyMeters; AccuracyMeters; gps_accuracy; Dokładność (m); Noggrannhet (m); Nøyaktighet; tarkkuus
"""
OF_OTHERS = """
verticalAccuracy; vAcc; acc_v; VerticalAccuracyMeters; SpeedAccuracyMps; BearingAccuracyDegrees; headingAccuracy; cAcc
sAcc; epv
locationHeadingAccuracy(°); courseAccuracy; coords.altitudeAccuracy; Vertikale Genauigkeit (m); Höhengenauigkeit
Précision verticale (m); Précision de la vitesse (m/s); precisión de velocidad; Precisión del rumbo; Precisão rumo
accuratezza verticale; accuratezza direzione; Richtungsgenauigkeit; koersnauwkeurigheid; 垂直精度 (m); 速度精度 (m/s)
方位精度; 方向精度; Точность высоты (м); точность направления; точность курса; 수직 정확도; 방향 정확도; yawAccuracy
speed_accuracy; speedAccuracy; bearingAccuracy; compass accuracy; locationCourseAccuracy(°); accelerometerAccuracy
Vertikale Genauigkeit (m); Précision verticale; Precisión vertical; Geschwindigkeitsgenauigkeit (m/s); accuracy (m/s)
hdop
precisión acelerómetro; magnetometerAccuracy; accuracy_status; elapsedRealtimeUncertaintyNanos; peilung genauigkeit
"""
COLUMNS = {
    "acceleration": """
accelerationIncludingGravity.x; acceleration_including_gravity_x; accel_with_gravity_x; acceleration_incl_grav_x
event.accelerationIncludingGravity.x; includingGravityX; Beschleunigung mit Gravitation x; Aceleração com g x (m/s^2)
Accélération avec g x (m/s^2); Aceleración con gravedad x; Accelerazione con g x; total_acc_x; totalAccX; WAL_acc_x
normal_acc_x; raw_acc_x; wrist_acc_x; TotalAcceleration x; rawAccelerometerX; x_acc; Accelerometer_X; tot_acc_x (m/s^2)
totalacc_x; TOTALACCX; normal_acc_x; medial acc x; globalAccX; wristaccx; accelerationIncludingGravityX
accG_x; accGx; acc_g_x; phone_accG_x; rawAccelG_x; aG_x
""",
    "linear_acceleration": """
linear_acc_x; linAccX; LinearAcceleration.x; lacc_x; laccX; acceleration_excluding_gravity_x; accWithoutGravity_x
acceleration without g x (m/s^2); userAcceleration.x; user_acc_x; motionUserAccelerationX(G); acc_no_gravity_x
acceleration_minus_gravity_x; Lineare Beschleunigung x (m/s^2); Beschleunigung ohne g x; Accélération sans g x
Aceleración sin g x; Aceleración lineal x; Accélération linéaire x; Accelerazione lineare x; Accelerazione senza g x
LACCX; LAccX; acc_without_gravity_x; linear_ax
Aceleração linear x; Aceleração sem g x; linaccel_x; linaccG_x
""",
    "gyroscope": """
rotationRate.alpha; rotation_rate_beta; rotationRateAlpha; rotationrate_alpha; gyro alpha; rotationRateX(rad/s)
motionRotationRateX(rad/s); gyroRotationX(rad/s); gyroX
gyr_x; angular_velocity_x; angularVelocity.x; omega_x; wx; rot_rate_x; turn_rate_x; ang_vel_x; GYROSCOPE X (rad/s)
Gyroskop x (rad/s); Giroscópio x (rad/s); Vitesse angulaire x (rad/s); body_gyro_x; uncal_gyro_x; calGyro_x
rate_x; rateX (deg/s); spinal_gyro_x
""",
    "magnetometer": "thermal_mag_x",
    "": """
flux; flight; flat; rotation.alpha; flight_x; acc_magnitude; accel_std; orientation_x; rotation_vector_x
quaternion_x; position_x; velocity_x; distance_x
index; jerk_x; accelerationAbsolute; screen_x; touch_x; max; heading_x; roll; pitch; speed; step_count; pdop accuracy
heart_rate_x; access_x; bag_x; lag_x; drag_x; frameRate_x
""",
}
FILES = {
    "acceleration": """
android.sensor.accelerometer
Accelerometer; acc; phone_acc; TotalAcceleration; wrist_accel; total_acc; WAL_acc; walk1-acc
left_accel_01; TYPE_ACCELEROMETER; accelerationIncludingGravity; accel_with_gravity; accelerometerIncludingGravity_walk
accdata; wristaccel; accelerometers; Beschleunigungssensor; accéléromètre
""",
    "linear_acceleration": """
LinearAcceleration; linacc; lacc; user_acceleration; android.sensor.linear_acceleration; acc_without_g
accelerationWithoutGravity; TYPE_LINEAR_ACCELERATION
""",
    "gyroscope": "GyroscopeUncalibrated; rotation_rate; AngularVelocity; TYPE_GYROSCOPE; gyr; walk_gyro; rotationRate; "
    "gyrodata; phonegyro",
    "magnetometer": "mag; MagneticField; android.sensor.magnetic_field; TYPE_MAGNETIC_FIELD; MagnetometerUncalibrated; "
    "maglog",
    "barometer": "Barometer; pressure; android.sensor.pressure; TYPE_PRESSURE; baro; barometer_1; pressures",
    "": "access; grave; preset; accent; gravel; press; long_walk; speed_test; heading_north; lightning; accelerated; "
    "positioning; Metadata; Annotation; walk; flight; image; magazine; steps; Pedometer; rotation; manager; program; "
    "highlights",
}
WALK = on_one_clock(a_walk(20.0))


def names(text: str) -> list[str]:
    return [name.strip() for line in text.strip().splitlines() for name in line.split(";")]


def of_quantity(table: dict[str, str]) -> list[tuple[str, str]]:
    return [(name, quantity) for quantity, text in table.items() for name in names(text)]


@pytest.mark.parametrize("name", names(HORIZONTAL))
def test_a_horizontal_accuracy_is_known_in_other_languages_and_apps(name: str) -> None:
    assert column_of(0, name).quantity == "accuracy"


@pytest.mark.parametrize("name", names(OF_OTHERS))
def test_an_accuracy_of_height_speed_direction_sensor_or_clock_is_not_horizontal(name: str) -> None:
    assert column_of(0, name).quantity == ""


@pytest.mark.parametrize(("name", "quantity"), of_quantity(COLUMNS))
def test_a_column_is_known_by_the_words_of_its_name(name: str, quantity: str) -> None:
    found = column_of(0, name)
    assert (found.quantity if found.axis or quantity else "") == quantity
    assert found.axis == ("" if not quantity else "y" if name.endswith("beta") else "x")


@pytest.mark.parametrize(("name", "quantity"), of_quantity(FILES))
def test_the_sensor_of_a_file_is_known_by_the_words_of_its_name(name: str, quantity: str) -> None:
    assert quantity_of_file(name)[0] == quantity


@pytest.mark.parametrize(
    "name",
    names("""
accelerometer.csv; Gyroscope.csv; gyro.txt; Magnetometer.csv; Location.csv; gps.csv; Barometer.csv; Gravity.csv
LinearAcceleration.csv; TotalAcceleration.csv; Orientation.csv; Metadata.csv; meta.csv; steps.csv; truth.csv
Accelerometer (1).csv; AccelerometerUncalibrated.csv; Pedometer.tsv; annotation.txt
"""),
)
def test_a_table_with_both_sensors_reads_whatever_its_file_is_called(tmp_path: Path, name: str) -> None:
    columns = {"time": WALK.accelerometer.time_s} | axes("acc%", WALK.accelerometer.values)
    text = table_text(columns | axes("gyro%", WALK.gyroscope.values))
    assert_same_streams(read(write_text(tmp_path / name, text)), WALK, "accelerometer gyroscope", 1e-6, 1e-9)


@pytest.mark.parametrize("name", names("access.csv; grave.csv; preset.csv; long_walk.csv; speed_test.csv; press.csv"))
def test_a_table_of_axes_reads_in_a_file_whose_name_only_contains_the_letters_of_a_sensor(
    tmp_path: Path, name: str
) -> None:
    text = table_text({"time": WALK.accelerometer.time_s} | axes("%", WALK.accelerometer.values))
    assert_same_streams(read(write_text(tmp_path / name, text)), WALK, "accelerometer", 1e-6, 1e-9)


def test_columns_with_a_g_behind_their_word_are_in_the_unit_that_their_size_shows(tmp_path: Path) -> None:
    for factor in (1.0, 1 / STANDARD_GRAVITY_MPS2):
        columns = {"time": WALK.accelerometer.time_s} | axes("accG_%", factor * WALK.accelerometer.values)
        path = write_text(tmp_path / "walk.csv", table_text(columns))
        assert_same_streams(read_any_table(path, platform="android"), WALK, "accelerometer", 1e-6, 1e-9)


def test_a_mapping_given_as_a_recording_is_refused_with_the_command_that_takes_it(tmp_path: Path) -> None:
    for text in ('[accelerometer]\ncolumns = ["a", "b", "c"]\n', 'time = { column = "t", unit = "s" }\n'):
        message = refusal(write_text(tmp_path / "walk.toml", text))
        assert f"pdr-filter convert FILE --map {tmp_path / 'walk.toml'}" in message
        assert "JSON" not in message


def test_columns_in_units_of_other_quantities_are_not_offered_as_an_accelerometer(tmp_path: Path) -> None:
    head = "Time (s),Latitude (°),Longitude (°),Height (m),Velocity (m/s),Direction (°),Vertical Accuracy (m)\n"
    rows = "".join(f"{k},10.0,20.0,3.0,1.2,90.0,4.0\n" for k in range(20))
    message = refusal(write_text(tmp_path / "Location.csv", head + rows))
    assert "no accelerometer" in message
    assert "Velocity" not in message
