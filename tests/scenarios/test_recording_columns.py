"""What columns are taken for, which numbers of a message, and times beyond the usual: on tables of a few rows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from railstate.scenarios import units
from railstate.scenarios.recorded.columns import Cells, Column
from railstate.scenarios.recorded.inspecting import suggested
from railstate.scenarios.recorded.readers import Table, read
from railstate.scenarios.recorded.readers.messages import DEEPEST, _numbers
from railstate.scenarios.recorded.readers.table import table_of
from railstate.scenarios.recorded.times import seconds

from ..recordings import ride


@pytest.mark.parametrize(("unit", "factor"), [("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_stamps_of_the_same_years_are_known_in_every_unit(unit: str, factor: float) -> None:
    for seconds_, known in ((8e8, True), (3.9e9, True), (4.4e9, False), (5.5e8, False),  # 1995, 2093; 2109, 1987
                            (6e8, False), (4e9, False)):
        found = suggested(table_of("t", {"time": factor * (seconds_ + np.arange(3.0)), "s [m]": np.arange(3.0)}, ""))
        assert found.map == {"time": f"time [{unit if known else 's'}]", "position": "s [m]"}
        assert found.why == {"time": "supposed by its size" if known or factor * seconds_ > 6e8 else "supposed"}


@pytest.mark.parametrize("known", ["s [m]", "s_ref [m]"])
def test_where_a_position_is_known_fixes_are_no_second_one(known: str) -> None:
    columns = {"time [s]": np.arange(3.0), "lat": np.full(3, 45.0), "lon": np.full(3, 15.0)}
    role = "reference_position" if "ref" in known else "position"
    assert suggested(table_of("t", {**columns, known: np.arange(3.0)}, "")).map == {"time": "time [s]", role: known}
    assert suggested(table_of("t", columns, "")).map == {"time": "time [s]", "latitude": "lat", "longitude": "lon"}


def test_units_in_names_are_no_words_of_a_role() -> None:
    """Seconds and kilometres are no positions by themselves; a whole name may be one."""
    for name, role, meant in (
            ("delay_s", "", ""), ("wagon_km", "", ""), ("delay in s", "", ""), ("v_m/s", "speed", "v_m/s"),
            ("s_km", "position", "s_km"), ("km", "position", "km [m]"), ("s", "position", "s [m]"),
            ("pos_gnss_m", "position", "pos_gnss_m"), ("s_ref_m", "reference_position", "s_ref_m"),
            ("train_a", "acceleration", "train_a [m/s^2]"), ("v in km/h", "speed", "v in km/h"),
            ("speed [km/h]", "speed", "speed [km/h]"), ("index_m", "", ""), ("odo_km", "odometer", "odo_km")):
        found = suggested(table_of("t", {"t_s": np.arange(3.0), name: np.arange(3.0)}, "")).map
        assert found == {"time": "t_s", **({role: meant} if role else {})}, name


def test_which_numbers_of_a_message_are_taken() -> None:
    message = {"v": 1, "_own": 2, "header": {"seq": 3}, "valid": True, "text": "4", "list": [5.0],
               "pose": {"covariance": {"a": 6}, "stamp": 7, "x": 8.5}}
    assert list(_numbers(message)) == [("v", 1.0), ("pose.x", 8.5)]

    def nested(levels: int) -> Any:
        return {"a": nested(levels - 1)} if levels else 9.0

    assert list(_numbers(nested(DEEPEST))) == [(".".join("a" * DEEPEST), 9.0)]
    assert list(_numbers(nested(DEEPEST + 1))) == []


def test_dates_that_nanoseconds_cannot_hold_keep_their_distances() -> None:
    dates = pa.array([32503680000, None, 32503680010], pa.timestamp("s"))  # in the year 3000
    found, kind = seconds(Table("t", pa.table({"time": dates}), ""), Column("time"), "", Cells())
    np.testing.assert_array_equal(found, [0.0, np.nan, 10.0])
    assert kind == "dates and times without zone"


def test_units_agree_with_each_other() -> None:
    time, length, speed, force = units.TIMES, units.LENGTHS, units.SPEEDS, units.ACCELERATIONS
    assert [time[name] for name in ("s", "sec", "min", "h")] == [1, 1, 60, 3600]
    assert [1 / time[name] for name in ("ms", "us", "µs", "ns")] == pytest.approx([1e3, 1e6, 1e6, 1e9])
    assert [length[name] for name in ("m", "km", "cm", "mm")] == [1, 1000, 0.01, 0.001]
    assert length["mi"] == pytest.approx(5280 * length["ft"]) and length["ft"] == pytest.approx(12 * 0.0254)
    for names, per, of in ((("m/s", "mps"), "m", "s"), (("km/h", "kmh", "kph"), "km", "h"), (("mph",), "mi", "h"),
                           (("ft/s",), "ft", "s"), (("cm/s",), "cm", "s")):
        assert [speed[name] for name in names] == pytest.approx([length[per] / time[of]] * len(names))
    assert 3600 * speed["kn"] == pytest.approx(1852)  # a nautical mile
    assert {force[name] for name in ("m/s^2", "m/s2", "m/s²", "mps2")} == {1.0} and force["g"] == 9.80665
    assert units.ANGLES == {"deg": 1.0, "°": 1.0} and units.MASSES == {"kg": 1.0, "t": 1000.0}
    assert units.SHARES == {"-": 1.0, "share": 1.0, "%": 0.01, "percent": 0.01}
    assert units.SLOPES == {"-": 1.0, "permil": 0.001, "%": 0.01}
    assert units.FORCES == {"N": 1.0, "kN": 1000.0} and units.POWERS == {"W": 1.0, "kW": 1000.0, "MW": 1e6}


@pytest.mark.parametrize(("columns", "meant", "quality"), [
    ({"fix": ["RTK fixed", "none", "GNSS"]}, {}, {}),
    ({"lat": [1.0, 2, 3], "fix": ["GNSS"] * 3}, {"latitude": "lat"}, {}),
    ({"s": [1.0, 2, 3], "fix": ["GNSS"] * 3, "v": [1.0, 2, 3]},
     {"position": "s [m]", "speed": "v [m/s]", "position_sd": "fix"}, {"GNSS": 3.0}),
    ({"lat": [1.0, 2, 3], "lon": [1.0, 2, 3], "accuracy": [1.0, 2, 3]},
     {"latitude": "lat", "longitude": "lon", "position_sd": "accuracy [m]"}, {}),
    ({"s_m": [1.0, 2, 3], "fix": ["GNSS", " ", "NaN"]}, {"position": "s_m", "position_sd": "fix"}, {"GNSS": 3.0}),
    ({"s_m": [1.0, 2, 3], "fix": ["GNSS", "none", "odd"]}, {"position": "s_m"}, {}),
    ({"s_m": [1.0, 2, 3], "accuracy_cm": [1.0, 2, 3]}, {"position": "s_m", "position_sd": "accuracy_cm"}, {})])
def test_how_good_a_reading_is_goes_with_the_reading(columns: dict[str, Any], meant: dict[str, str],
                                                     quality: dict[str, float]) -> None:
    found = suggested(table_of("t", {"t_s": np.arange(3.0), **{
        name: values if isinstance(values[0], str) else np.array(values) for name, values in columns.items()}}, ""))
    assert found.map == {"time": "t_s", **meant} and found.quality == quality


@pytest.mark.parametrize("first", ["a", "odo", "v"])
def test_units_are_found_in_any_order_of_columns(first: str, tmp_path: Path) -> None:
    """By the way of the position, whatever stands before, also what cannot be read."""
    true = ride()
    columns = {"a": true.a_mps2, "odo": 7.0 + 0 * true.s_m, "v": 3.6 * true.v_mps}
    true[["t_s", "s_m"]].assign(**{first: columns[first], **columns}).to_csv(tmp_path / "trip.csv", index=False)
    found = suggested(read(str(tmp_path / "trip.csv")))
    assert found.map == {"time": "t_s", "position": "s_m", "speed": "v [km/h]", "odometer": "odo [m]",
                         "acceleration": "a [m/s^2]"}
    supposed = "supposed: the name tells no unit"
    assert found.why == {"speed": "its way is 1 times that of the position", "odometer": supposed,
                         "acceleration": supposed}
