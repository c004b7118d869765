"""What scenarios do where few files lead: refusals in whole words, branches against plain loops.

Trips that do not end, tables that are none, columns of odd types, networks, sensors beside a linear model."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pytest
from pydantic import BaseModel
from railstate.benchmarks.planning.naming import find_one
from railstate.scenarios import files, machine_code, registry
from railstate.scenarios.aboard.config import Instruments
from railstate.scenarios.aboard.told import hearing
from railstate.scenarios.channels import Delay, RoundRobin, TryOnceDiscard
from railstate.scenarios.coupled_cars.config import CarAccess, of_cars
from railstate.scenarios.errors import InputError
from railstate.scenarios.faults import Readings
from railstate.scenarios.faults.noise import StudentT
from railstate.scenarios.files import load
from railstate.scenarios.keys import keys_of
from railstate.scenarios.linear.setting import LinearSystem
from railstate.scenarios.measurement import untold
from railstate.scenarios.model import _wants
from railstate.scenarios.recorded import recording
from railstate.scenarios.recorded.columns import Cells, classed, numbers
from railstate.scenarios.recorded.config import Plant
from railstate.scenarios.recorded.inspecting import described, suggested
from railstate.scenarios.recorded.readers import Table, delimited, reading
from railstate.scenarios.recorded.recording import Meaning, read_recording
from railstate.scenarios.schema import Augment
from railstate.scenarios.world import Later, Sensing
from scipy.stats import chi2

from .. import models
from ..models import whole
from .test_refusals import TRACK


def refused(message: str, error: type[Exception] = InputError) -> Any:
    return pytest.raises(error, match=f"^{re.escape(message)}$")


def table(**columns: Any) -> Table:
    return Table("f", pa.table({name.replace("__", " "): values for name, values in columns.items()}), "")


@pytest.mark.parametrize(("name", "key", "value", "said"), [
    ("ningbo-metro", "plant.controller.margin", 21.5, "after 2060 s of w = -w_bar it is at 973 m of 1900 m"),
    ("odometry", "plant.driver.courage", [0.01, 0.9], "after 9360 s it is at 1850 m of 8900 m")])
def test_trips_that_do_not_end(name: str, key: str, value: Any, said: str) -> None:
    scenario, variant = find_one(name, {key: value})
    setting: Any = scenario.setting(variant)
    with refused(f"{name}: the train does not reach its last stop: {said}"):
        setting.batch_bytes()


def test_what_belongs_to_the_built_in_line_must_be_tables(tmp_path: Path) -> None:
    (tmp_path / "line.json").write_text(json.dumps(TRACK))
    for key in ("plant.adhesion", "plant.elsewhere"):
        with pytest.raises(InputError) as caught:
            find_one("odometry", {"plant.line": str(tmp_path / "line.json"), key: 5})
        said = f"{key}: Input should be a valid dictionary or instance of {key[6:].title()} (got 5)"
        assert said in str(caught.value)


def test_sensors_beside_a_linear_model_are_rows_of_it() -> None:
    """Places alone, which read the position: the linear form says what the functions say."""
    model = models.linear(2, correlated=True)
    own, instruments = model.linear, Instruments()
    heard = hearing(model, ("gnss", "balise"), instruments, 0.1)
    form = heard.linear
    assert own is not None and form is not None
    assert heard.measurement_jacobian is not None and heard.measurement_covariance is not None
    for k in (0, 3):
        R, C = np.zeros((4, 4)), np.zeros((4, 3))
        R[:2, :2], C[:2] = own.R(k), own.C(k)
        R[2, 2], R[3, 3] = instruments.gnss.told**2, instruments.balise.location[0]**2 + instruments.balise.detection**2
        C[2:, 0] = 1.0
        np.testing.assert_allclose(form.R(k), R, rtol=1e-15)
        np.testing.assert_allclose(heard.measurement_covariance(untold(k, 4))[:, :, 0], R, rtol=1e-15)
        np.testing.assert_array_equal(form.C(k), C)
        np.testing.assert_array_equal(heard.measurement_jacobian(model.initial_mean, k)[:, :, 0], C)
        assert form.A is own.A and form.Q is own.Q
    assert hearing(replace(model, linear=None), ("gnss",), instruments, 0.1).linear is None
    assert hearing(model, (), instruments, 0.1) is model


def test_inputs_however_they_lie_in_memory() -> None:
    model, u = models.linear(4), np.arange(-2.0, 6.0)[None]
    wanted = model.transition(model.initial_mean, u[:, ::2].copy(), whole(0))
    for given in (u[:, ::2], u[:, ::2].astype(np.float32), np.array([[-2, 0, 2, 4]])):
        np.testing.assert_array_equal(model.transition(model.initial_mean, given, whole(0)), wanted)


def test_cars_are_the_nodes_where_none_are_told() -> None:
    each, other = [[0, 3], [1, 4], [2, 5]], [[0, 1, 2], [3, 4, 5]]
    turn, tod = RoundRobin(kind="round-robin"), TryOnceDiscard(kind="try-once-discard", nodes=other)
    late: Any = Delay.model_validate({"kind": "delay", "steps": 2, "loss": {"kind": "round-robin"}})
    told_late: Any = Delay.model_validate({
        "kind": "delay", "steps": 2, "loss": {"kind": "round-robin", "nodes": other}})
    found: list[Any] = [of_cars(channel, 3) for channel in (turn, tod, late, told_late)]
    assert [found[0].nodes, found[1].nodes, found[2].loss.nodes, found[3].loss.nodes] == [each, other, each, other]
    assert found[2].steps == late.steps and found[1] is tod and found[3] is told_late
    drawn = of_cars(CarAccess(kind="random-access-cars"), 3)
    assert drawn.model_dump() == {
        "kind": "random-access", "silent": "nothing", "p": [1 / 3] * 3, "nodes": each}


def test_forces_of_no_law_are_alike_for_all_cars() -> None:
    setting: Any = find_one("cbtc-csma/uniform", {"disturbance.c0": 0.0, "disturbance.c1": 0.0, "disturbance.c2": 0.0})
    scenario, variant = setting
    cars = scenario.setting(variant)
    told_of = SimpleNamespace(speed_limit=20.0, delta=6.0)
    np.testing.assert_allclose(cars._delta(told_of), 6.0 / np.sqrt(cars.cars), rtol=1e-15)
    assert not cars._delta(SimpleNamespace(speed_limit=20.0, delta=None)).any()


def test_heavy_tails_where_the_noise_is_unknown() -> None:
    """Student's t of the sensor's deviation is added to its readings within the fault's time, to no others."""
    steps, runs, rng = 5, 2, np.random.default_rng(3)
    chance, normal = rng.uniform(size=(2, steps, 1, runs))
    asked = list[Any]()

    class Random:
        def uniform(self, low: float, high: float, *shape: int) -> np.ndarray:
            asked.append((low, high, shape))
            return chance

        def normal(self, *shape: int) -> np.ndarray:
            asked.append(shape)
            return normal

    Random.runs = range(runs)  # pyright: ignore
    y, none = rng.normal(size=(steps, 2, runs)), np.zeros((steps, 2, runs), dtype=bool)
    readings = Readings(Sensing(("a", "b"), np.array([1.0, 0.5])), np.arange(5.0), y.copy(), ~none, None, None, none,
                        none)
    fault: Any = StudentT.model_validate({"kind": "student-t", "sensors": ["b"], "dof": 4.0, "from": 1.0, "to": 3.0})
    fault.apply(Random(), readings)
    wanted = y.copy()
    for k in range(steps):
        for run in range(runs):
            if 1 <= k < 3:
                wide = np.sqrt(4.0 / chi2(4.0).ppf(1 - chance[k, 0, run]))
                wanted[k, 1, run] += 0.5 * wide * normal[k, 0, run]
    np.testing.assert_allclose(readings.y, wanted, rtol=1e-12)
    assert asked == [(0.0, 1.0, (steps, 1)), (steps, 1)] and not readings.faulty.any()


def test_a_setting_without_sensors_takes_no_faults(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LinearSystem, "sensing", lambda self: None)
    fault = [{"kind": "stuck", "sensors": ["y1"], "from": 1.0, "to": 2.0}]
    with refused("rap-example-1: faults: this setting does not say what its sensors are, and takes none"):
        load("rap-example-1", {"faults": fault}, "corrected")
    assert load("rap-example-1", {}, "corrected")


def test_places_of_origins_lead_to_keys() -> None:
    class Part(BaseModel):
        label: str = "one"
        size: float = 1.0

    class Whole(BaseModel):
        entries: tuple[Part, ...] = (Part(), Part(label="two"))
        names: dict[str, Any] = {"a": {"b": 1}}
        listed: list[int] = [1]

    found = {path: files._names_a_key(path, Whole()) for path in (
        "entries", "entries.two.size", "entries.three", "entries.two.weight", "names.a.b", "names.a.c", "names.a.b.c",
        "listed.0", "other")}
    assert [path for path, there in found.items() if there] == ["entries", "entries.two.size", "names.a.b"]


def test_a_stray_origin_is_told_where_all_variants_can_be_read(tmp_path: Path) -> None:
    """A variant that nobody asked for and that is wrong might have had the key."""
    text = ('name = "mine"\nbase = "rap-example-1/corrected"\norigin = { "plant.nowhere" = "a book" }\n'
            "variants.one.plant.x0 = [1.0, 0.0, 0.0]\nvariants.two.plant.x0 = ")
    (tmp_path / "wrong.toml").write_text(text + '"far"')
    (tmp_path / "right.toml").write_text(text + "[2.0, 0.0, 0.0]")
    assert load(str(tmp_path / "wrong.toml"), {}, "one").setting("one").config.plant.x0 == [1.0, 0.0, 0.0]
    with refused(f"{tmp_path}/right.toml: origin.plant.nowhere: names no key of this scenario"):
        load(str(tmp_path / "right.toml"), {}, "one")


def test_a_file_that_is_no_text(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_bytes(b"name = \"\xff\"\n")
    with refused(f"{tmp_path}/a.toml: cannot be read: 'utf-8' codec can't decode byte 0xff in position 8: invalid "
                 "start byte"):
        load(str(tmp_path / "a.toml"))


def test_keys_of_tables_of_several_kinds() -> None:
    class A(BaseModel):
        form: Literal["round", "square"] = "round"

    class B(BaseModel):
        b: int = 2

    class Whole(BaseModel):
        one: A | B
        only: B = B()

    assert [tuple(key) for key in keys_of(Whole, of="top")] == [
        ("one", "top", "", "", "required", False), ("one.form", "round, square", "", "", '"round"', False),
        ("one.b", "top", "", "", "2", True), ("only", "top", "", "", '{"b": 2}', False),
        ("only.b", "top", "", "", "2", True)]


def test_machine_code_that_is_a_part_of_other_machine_code(monkeypatch: pytest.MonkeyPatch) -> None:
    @machine_code.njit(inner=True)
    def half(x: float) -> float:
        return x / 2

    with refused("half is called from compiled code alone", TypeError):
        half(3.0)
    monkeypatch.setattr(machine_code, "_places", lambda: iter(()))
    assert machine_code.place("stem", "version") is None


def test_functions_that_do_not_say_what_they_take() -> None:
    assert (_wants(None), _wants(max), _wants(lambda x, u, *, interval=1: x), _wants(lambda x, u=1: x)) == (0, 0, 2, 1)


def test_settings_of_others_and_tables_that_do_not_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """A kind that a plug-in brings is its own; what does not fit the schema is refused by its key."""
    class Own(LinearSystem):
        kind = "own"

    monkeypatch.setattr(registry, "settings", lambda: {"own": Own})
    assert registry.setting_for("own", "a.toml") is Own
    with refused("a.toml: plant.kind = \"none\" is unknown; allowed: own"):
        registry.setting_for("none", "a.toml")
    with pytest.raises(InputError) as caught:
        registry.setting_of({"plant": {"kind": "linear", "A": 3}, "nmae": "a"}, "a.toml")
    lines = str(caught.value).splitlines()
    keys = "name title default source notes origin fitted time plant disturbance sensors channel faults knowledge score"
    assert lines == [
        "a.toml.name: missing", "a.toml.title: missing", "a.toml.time: missing",
        "a.toml.plant.A: Input should be a valid list (got 3)",
        *(f"a.toml.plant.{key}: missing" for key in ("B", "C", "Q", "R", "x0", "P0")), "a.toml.estimators: missing",
        f"a.toml.nmae: unknown key (got 'a'); allowed: {', '.join(keys.split())}, requirements, estimators"]


def test_extra_states_that_cannot_be() -> None:
    setting: Any = load("rap-example-1", {}, "corrected").setting("corrected")
    assert super(LinearSystem, setting).sensing() is None
    with refused('augment.bias 1: kind = "gauss-markov" needs a time_constant in s'):
        setting.told({}, {"bias": Augment.model_validate({"kind": "gauss-markov", "sd": 1.0})}, np.zeros((3, 1)))


def test_arrays_made_when_they_are_first_asked_for() -> None:
    made = list[int]()

    def make() -> dict[str, np.ndarray]:
        made.append(1)
        return {"a": np.ones(2), "b": np.zeros(3)}

    later = Later(make)
    assert made == []
    assert (len(later), list(later), later["b"].tolist(), made) == (2, ["a", "b"], [0.0] * 3, [1])


@pytest.mark.parametrize(("values", "said"), [
    (pa.array([[1.0], [2.0]]), 'f: column "a" holds list<item: double>: numbers are needed'),
    (pa.array([{"b": 1.0}]), 'f: column "a" holds struct<b: double>: numbers are needed'),
    (pa.array([True]), 'f: column "a" holds bool: numbers are needed, times as seconds')])
def test_columns_that_hold_no_numbers(values: pa.Array, said: str) -> None:
    with refused(said, ValueError):
        numbers(table(a=values), "a", Cells())


def test_classes_of_fixes_and_numbers_in_their_place() -> None:
    classes = {"RTK": 0.05, "GNSS": 3.0}
    np.testing.assert_array_equal(classed(table(q=["RTK", " GNSS ", "none", None]), "q", classes),
                                  [0.05, 3.0, np.nan, np.nan])
    assert classed(table(q=["1.5", "2,5", "nan"]), "q", classes) is None
    for cells, unknown in ((["1.5", "RTK"], "1.5"), (["a", "2"], "a, 2")):
        with refused(f'plant.quality: f has {unknown} in "q" without a standard deviation: quality = '
                     f'{{ {unknown.split(",")[0]} = 3.0, .. }}, or "missing"', ValueError):
            classed(table(q=cells), "q", classes)


def test_what_columns_may_be_taken_for() -> None:
    """Words of quality that nobody knows, dates, balises by name, numbers in dispute over their decimal sign."""
    stamps = pa.array([0, 1000, 2000], pa.timestamp("ms"))
    way = [0.0, 1.0, 2.0]
    found = suggested(table(time=stamps, s_m=way, fix_quality=["A", "B", "C"], balise=["x", None, "y"]), True)
    assert found.map == {"time": "time", "position": "s_m", "balise": "balise"} and found.quality == {}
    found = suggested(table(time=stamps, s_m=way, fix_quality=["RTK fixed", "none", None], index=[1, 2, 3]))
    assert found.map == {"time": "time", "position": "s_m", "position_sd": "fix_quality"}
    assert found.quality == {"RTK fixed": 0.05, "none": "missing"}
    odd = table(time=["1,5", "2.5", "3"], s_m=["1.5", "2,5", "3"])
    found = suggested(odd)
    assert found.map == {"time": "time [s]", "position": "s_m"} and found.why == {"time": "supposed"}
    told_of = described(table(t=["1.5", "2,5"], a=["0,5", "3"]), "t")
    assert told_of["from"].tolist() == ["row 2 has '2,5'", "row 1 has '0,5'"]
    assert told_of["step s"].tolist() == ["", ""]
    plain = described(table(t=[0.0, 1.0, 4.0], a=[2.0, None, -1.0], w=["x", "y", "z"], p=["x", "y", "x"]), "t [s]")
    assert plain.to_dict("list") == {
        "column": [*"tawp"], "values": [3, 2, 3, 3], "step s": ["2", "4", "", ""], "longest gap s": ["3", "4", "", ""],
        "from": ["0", "-1", "x, y, .. (3)", "x, y"], "to": ["4", "2", "", ""], "largest change": ["3", "3", "", ""]}


def test_simulated_balises_of_a_recording(tmp_path: Path) -> None:
    """Those named within the trip, in their order."""
    trip: Any = SimpleNamespace(position=np.array([100.0, 900.0, 400.0]))
    (tmp_path / "places.csv").write_text("name,position_km\na,0.5\nb,0.05\nc,0.2\n")
    for balises in ({"a": 500.0, "b": 50.0, "c": 200.0}, str(tmp_path / "places.csv")):
        assert Plant.laid(SimpleNamespace(balises=balises), trip) == ([200.0, 500.0], [])  # pyright: ignore


def test_a_delimiter_is_known_by_whole_lines(tmp_path: Path) -> None:
    """The line that the sample ends within does not count."""
    names = [f"a{i}" for i in range(1000)]
    rows = [";".join(f"{i + k / 10:.3f}" for i in range(1000)) for k in range(40)]
    data = "\n".join([";".join(names), *rows]).encode()
    assert len(data) > 200_000
    found = delimited.read_delimited("f", data)
    assert found.names == names and found.rows == 40 and found.said == "CSV: semicolons, UTF-8"


def test_a_file_that_closes_before_it_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t_s,s_m\n0,1\n1,2\n2,4\n")

    def gone(*_: object) -> Any:
        raise PermissionError(13, "Permission denied")

    with monkeypatch.context() as closed:
        closed.setattr(Path, "open", gone)
        with refused(f"{path}: cannot be read: Permission denied", ValueError):
            reading.read(str(path))
    meaning = Meaning((("position", "s_m"), ("time", "t_s")))
    small = read_recording(str(path), meaning)
    monkeypatch.setattr(recording, "KEPT", 2)
    recording._recording.cache_clear()
    large = read_recording(str(path), meaning)
    assert recording._table.cache_info().currsize == 0
    np.testing.assert_array_equal(large.position, small.position)
    assert large.said == small.said and large.position.tolist() == [1.0, 2.0, 4.0]
