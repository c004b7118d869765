"""Recordings that do not fit: each gets one message, or leaves out the variants and estimators that need more."""

from __future__ import annotations

import numpy as np
import pytest
from railstate.scenarios.errors import InputError, Unsupported
from railstate.scenarios.files import load

from tests.scenarios.test_recorded import MAP, recording, run, setting, trip

__all__ = ["recording"]


def broken(change):
    table = trip()
    change(table)
    return table


@pytest.mark.parametrize(("change", "columns", "message"), [
    (lambda t: t.pop("odo_m"), MAP, "has no column \"odo_m\"; it has t_s"),
    (lambda t: t.insert(0, "odd_m", "far"), {**MAP, "odometer": "odd_m"}, "\"odd_m\" is not numeric: row 1 has 'far'"),
    (lambda t: t.__setitem__("t_s", t.t_s[::-1].to_numpy()), MAP, "time must increase"),
    (lambda t: t.__setitem__("t_s", t.t_s.where(t.index != 4)), MAP, "the time is missing in row 5"),
    (lambda t: t.__setitem__("s_km", t.s_km.where(t.index > 95)), MAP, "values; at least three are needed"),
    (lambda t: None, {**MAP, "speed": "v_knots"}, "has no column \"v_knots\""),
    (lambda t: None, {**MAP, "speed": "v_mps [furlong]"}, "allowed: m/s, mps, km/h"),
    (lambda t: None, {**MAP, "altitude": "z_m"}, "map.altitude: no such role; allowed: time, position"),
    (lambda t: None, {"position": "gnss_m"}, "map: needs time and position"),
    (lambda t: t.__setitem__("odo_m", np.nan), MAP, "odometer (odo_m) has no value in any row"),
    (lambda t: t.__setitem__("odo_m", 7.0), MAP, "the odometer odo_m never counts"),
    (lambda t: t.__setitem__("v_kmh", t.v_kmh > 3), MAP, "column \"v_kmh\" is not numeric: row 1 has 'False'"),
    (lambda t: t.insert(0, "u_share", 3.0), {**MAP, "control": "u_share"}, "control u_share is a share"),
])
def test_bad_recordings_get_one_message(tmp_path, change, columns, message):
    broken(change).to_csv(tmp_path / "trip.csv", index=False)
    with pytest.raises(InputError) as caught:
        load("recorded", {"plant.recording": str(tmp_path / "trip.csv"), "plant.map": columns})
    assert message in str(caught.value)
    assert str(caught.value).count("\n") == 0


def test_files_that_are_no_recording(tmp_path):
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "trip.parquet").write_text("not parquet")
    for name, message in (("none.csv", "cannot be read"), ("empty.csv", "not a CSV table"),
                          ("trip.parquet", "not a Parquet table")):
        with pytest.raises(InputError, match=message):
            load("recorded", {"plant.recording": str(tmp_path / name), "plant.map": MAP})


def test_too_few_rows(tmp_path):
    trip().head(2).to_csv(tmp_path / "trip.csv", index=False)
    with pytest.raises(InputError, match="needs at least three rows, but has 2"):
        setting(str(tmp_path / "trip.csv"))


def test_what_a_recording_lacks_leaves_out_what_needs_it(recording):
    scenario = load("recorded", {"plant.recording": recording, "plant.map": {"time": "t_s", "position": "gnss_m"}})
    assert tuple(scenario.variants) == ("outage", "sweep", "as-recorded")
    assert "sensors.use has speed, odometer, but plant.map has position" in scenario.unfit["odometer"][0]
    blind = scenario.setting("outage")
    with pytest.raises(Unsupported, match="needs an odometer or a speed"):
        run(blind, "dead-reckoning", 2)
    only = load("recorded", {"plant.recording": recording, "plant.map": {
        name: MAP[name] for name in MAP if name != "speed"}}).setting("as-recorded")
    assert run(only, "dead-reckoning", 1, "as-recorded")[2].scored.metrics["rmse", "speed"][0] > 0.5


def test_variants_whose_outage_is_longer_than_the_trip_are_left_out(recording):
    changes = {"plant.recording": recording, "plant.map": MAP, "sensors.outage.duration": 500.0}
    scenario = load("recorded", changes)
    assert tuple(scenario.variants) == ("as-recorded", "odometer")
    assert scenario.unfit and all("do not fit into the recording" in why for why, in scenario.unfit.values())
