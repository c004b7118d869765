"""Scenario files: bad ones end in one message each, exit code 2, no traceback; good ones resolve as they say."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from railstate.benchmarks.api.listing import scenario_lines
from railstate.scenarios import strict
from railstate.scenarios.files import load, merge
from railstate.scenarios.keys import keys_of
from railstate.scenarios.registry import scenario_files, settings

from ..conftest import SCENARIO, Command

BAD = {
    "not-toml": ("name = ", "not valid TOML"),
    "empty": ("", "is empty"),
    "wrong-type": (SCENARIO.replace("steps = 40", 'steps = "many"'), "time.steps"),
    "unknown-key": (SCENARIO.replace("period = 1.0", "period = 1.0\nperoid = 2"),
                    "time.peroid: unknown key (got 2); allowed: period, steps"),
    "unknown-channel-key": (SCENARIO.replace("p = 0.8", "p = 0.8\nq = 1"),
                            "channel.q: unknown key (got 1); allowed: silent, kind, p"),
    "negative-period": (SCENARIO.replace("period = 1.0", "period = -1.0"), "time.period"),
    "negative-variance": (SCENARIO.replace("R = [[1]]", "R = [[-1]]"), "plant.R"),
    "missing": (SCENARIO.replace("R = [[1]]\n", ""), "plant.R: missing"),
    "probability": (SCENARIO.replace("p = 0.8", "p = 1.8"), "channel.p"),
    "no-plant": (SCENARIO.replace('kind = "linear"\n', ""), "plant.kind: missing"),
    "unknown-plant": (SCENARIO.replace('"linear"', '"hovercraft"'), "allowed: "),
    "nodes-of-nothing": (SCENARIO.replace('kind = "bernoulli"\np = 0.8', 'kind = "random-access"\np = [1]\n'
                                          'nodes = [[1]]'), "channel.nodes list the measurement elements 1"),
    "divergence-of-nothing": (SCENARIO.replace("[plant]", "[score]\ndivergence = { positon = 3.0 }\n[plant]"),
                              "score.divergence.positon: no such quantity; allowed: position, speed"),
    "origin-of-nothing": (SCENARIO.replace("[plant]", '[origin]\n"plant.mass" = "guessed"\n[plant]'),
                          "origin.plant.mass: names no key"),
    "variant-name": (SCENARIO + '[variants."a b/c"]\ntitle = "x"\n', 'variants: "a b/c" is no name'),
    "label-name": (SCENARIO.replace("[estimators.half]", '[estimators."h/f"]'), "estimators.h/f"),
    "nothing-scored": (SCENARIO.replace("[plant]", "[score]\nskip = 50\n[plant]"), "score.skip = 50 s"),
    "unknown-channel": (SCENARIO.replace('"bernoulli"', '"pigeon"'), "channel"),
    "variant-of-nothing": (SCENARIO + "[variants.more]\n", "variants.more: changes nothing"),
    "variant-unknown-table": (SCENARIO + "[variants.more.wheels]\nx = 1\n", "unknown key wheels"),
    "unknown-estimator": (SCENARIO.replace('plugin = "half"', 'plugin = "halve"'), 'no estimator "halve"'),
    "no-estimators": (SCENARIO.replace('[estimators.half]\nplugin = "half"\n', ""), "estimators: missing"),
    "infinite": (SCENARIO.replace("period = 1.0", "period = inf"), "time.period"),
    "no number": (SCENARIO.replace("period = 1.0", "period = nan"), "time.period"),
}


def test_a_bad_file_is_one_message(railstate: Command, expected: Callable[[str, str], None]) -> None:
    said = []
    for name, (text, words) in BAD.items():
        Path(f"{name}.toml").write_text(text)
        done = railstate("run", f"{name}.toml", "--plugin", "half.py", "--runs", 2, "--out", "out")
        assert done.code == 2 and done.out == "" and words in done.err and len(done.err.splitlines()) == 1, name
        said.append(done.err)
    assert not Path("out").exists()
    expected("bad-files", "".join(said))


def test_all_mistakes_at_once(railstate: Command) -> None:
    Path("bad.toml").write_text(SCENARIO.replace("period = 1.0", "period = -1").replace("steps = 40", "stebs = 40")
                                .replace("p = 0.8", "p = 0"))
    done = railstate("run", "bad.toml", "--plugin", "half.py")
    assert done.code == 2
    for expected in ("time.period", "time.steps: missing", "time.stebs: unknown key", "channel.p"):
        assert sum(expected in line for line in done.err.splitlines()) == 1


BAD_WORDS: list[tuple[tuple[str, ...], str]] = [
    (("run", "nowhere"), "no such scenario and no such file"),
    (("run", "."), "is a directory"),
    (("run", "ningbo-metr"), "did you mean ningbo-metro?"),
    (("run", "cart.toml/steep"), 'there is no variant "steep"; allowed: calm, rough'),
    (("run", "cart.toml", "--plugin", "half.py", "--estimators", "thirds"), "thirds"),
    (("run", "cart.toml", "--plugin", "half.py", "--set", "channel.p"), "KEY=VALUE"),
    (("run", "cart.toml", "--plugin", "half.py", "--set", "channel.q=1"), "channel.q: unknown key"),
    (("run", "cart.toml", "--plugin", "half.py", "--runs", "0"), "--runs"),
    (("run", "cart.toml", "--plugin", "none.py"), "no such file"),
    (("run", "cart.toml", "--plugin", "half.py", "--out", "cart.toml"), "not a results folder"),
    (("run", "ningbo-metro", "--line", "absent.json"), "no such file"),
    (("replay", "cart/calm/half"), "expected SCENARIO/VARIANT/ESTIMATOR/RUN"),
    (("replay", "cart/calm/half/1", "--out", "absent"), "not a results folder"),
    (("show", "nothing"), "no such scenario"),
    (("sweep", "cart.toml", "--plugin", "half.py", "--over", "channel.p"), "KEY=V1,V2"),
]


def test_bad_words_are_one_message(railstate: Command, expected: Callable[[str, str], None]) -> None:
    said = []
    for words, part in BAD_WORDS:
        done = railstate(*words)
        assert done.code == 2 and part in done.err and "Traceback" not in done.err, words
        said.append(f"{' '.join(words)}\n{done.err}")
    expected("bad-words", "".join(said).replace(str(Path.cwd()), "DIR"))


def test_a_damaged_part_is_named(railstate: Command) -> None:
    words = ("run", "cart.toml/calm", "--plugin", "half.py", "--estimators", "half", "--runs", 4, "--out", "out")
    railstate(*words)
    part = next(Path("out/rows").glob("*.parquet"))
    part.write_bytes(part.read_bytes()[:100])
    done = railstate(*words)
    assert done.code == 2 and part.name in done.err and "damaged" in done.err


@pytest.mark.parametrize("name", sorted(scenario_files()))
def test_built_in_scenarios_resolve_and_explain_themselves(name: str) -> None:
    scenario = load(name)
    assert scenario.name == name
    for variant in scenario.variants:
        config = scenario.setting(variant).config
        assert config.title and config.source


def test_a_line_of_the_list_is_what_the_scenario_is() -> None:
    lines = {line["scenario"]: line for line in scenario_lines()}
    for name in ("ningbo-metro", "braking-rate"):
        scenario = load(name)
        config = scenario.setting(scenario.default).config
        assert scenario.requested and lines[name] == {
            "scenario": name, "about": config.title, "estimators": tuple(config.estimators),
            "variants": tuple(variant for variant in scenario.variants if variant not in scenario.requested),
            "variants on request": tuple(variant for variant in scenario.variants if variant in scenario.requested)}


def test_list_show_schema(railstate: Command) -> None:
    listed = railstate("list")
    assert listed.code == 0 and all(name in listed.out for name in scenario_files())
    shown = railstate("show", "ningbo-metro/white")
    assert shown.code == 0 and "disturbance.form" in shown.out and "ningbo-metro/white" in shown.out
    estimator = railstate("show", "ukf")
    assert estimator.code == 0 and "points" in estimator.out and "claims: mean, covariance" in estimator.out
    schema = json.loads(railstate("schema").out)
    assert {"$ref": "#/$defs/metro"} in schema["anyOf"]


@pytest.mark.parametrize("name", sorted(scenario_files()))
def test_every_number_of_a_built_in_scenario_has_its_origin(name: str, railstate: Command) -> None:
    scenario = load(name)
    for variant in scenario.variants:
        lines = iter(railstate("show", f"{name}/{variant}").out.splitlines())
        header = next(line for line in lines if line.split() == ["key", "value", "from", "origin"])
        value_at, from_at, origin_at = (header.index(name) for name in ("value", "from", "origin"))
        next(lines)  # the rule under the header
        for line in lines:
            if not line.strip():
                break
            key, value, origin = line[:value_at].strip(), line[value_at:from_at], line[origin_at:].strip()
            if key and not key.startswith("score.") and any(letter.isdigit() for letter in value):
                assert origin, f"{name}/{variant}: {key} = {value}"


def test_merge_replaces_a_table_of_another_kind() -> None:
    base = {"channel": {"kind": "csma", "p": 0.5, "trains": 2}, "plant": {"mass": 1, "length": 2}}
    merged = merge(base, {"channel": {"kind": "bernoulli", "p": 0.9}, "plant": {"mass": 3}})
    assert merged == {"channel": {"kind": "bernoulli", "p": 0.9}, "plant": {"mass": 3, "length": 2}}


OWN = """
name = "my-metro"
title = "Stronger wind, and a filter that is told of it"
base = "ningbo-metro"

[disturbance]
w_bar = 0.3
[knowledge]
w_bar = 0.3
[estimators.cautious]
plugin = "ekf"
knowledge = { sigma_w = 0.4 }
"""


def test_a_file_over_a_base_says_what_is_its_own(railstate: Command) -> None:
    """Eleven lines: all else is the base's, with its variants and origins; what comes from where is shown."""
    Path("my-metro.toml").write_text(OWN)
    own, base = load("my-metro.toml"), load("ningbo-metro")
    assert list(own.variants) == list(base.variants) and own.default == base.default and own.requested == base.requested
    for variant in ("switching", "physical-bias", "late"):
        expected = merge(base.variants[variant], {"disturbance": {"w_bar": 0.3}, "knowledge": {"w_bar": 0.3}})
        table = own.variants[variant]
        assert {key: table[key] for key in ("time", "plant", "disturbance", "sensors", "knowledge", "score")} == {
            key: expected[key] for key in ("time", "plant", "disturbance", "sensors", "knowledge", "score")}
        assert own.content_hash(variant) != base.content_hash(variant)
        assert table["estimators"].keys() == {*base.variants[variant]["estimators"], "cautious"}
    origin = own.setting("switching").config.origin
    assert origin["plant.train.braking"] == "public line set of Beijing Yizhuang"
    assert origin["disturbance.w_bar"] == "set in my-metro.toml" and origin["sensors"] == "chosen here"
    said = railstate("show", "my-metro.toml/white").out
    assert "base: ningbo-metro" in said
    lines = {line.split()[0]: line for line in said.splitlines() if line.strip()}
    assert "my-metro.toml" in lines["disturbance.w_bar"] and "set in" in lines["disturbance.w_bar"]
    assert "ningbo-metro/w" in lines["disturbance.form"]
    assert "default" in lines["channel.silent"]


def test_bases_are_files_variants_and_bases_of_bases(railstate: Command) -> None:
    Path("sub").mkdir()
    Path("sub/cart.toml").write_text(SCENARIO)
    Path("rough.toml").write_text('name = "rough"\nbase = "sub/cart.toml/rough"\n[channel]\np = 0.5\n')
    Path("rougher.toml").write_text('name = "rougher"\nbase = "rough.toml"\n[variants.less.channel]\np = 0.1\n')
    rough, rougher = load("rough.toml"), load("rougher.toml")
    assert list(rough.variants) == ["default"] and rough.variants["default"]["plant"]["Q"] == [[1.0]]
    assert list(rougher.variants) == ["less"] and rougher.variants["less"]["channel"] == {"kind": "bernoulli", "p": 0.1}
    assert rougher.variants["less"]["plant"] == rough.variants["default"]["plant"]
    before = rough.content_hash("default")
    Path("sub/cart.toml").write_text(SCENARIO.replace("steps = 40", "steps = 41"))
    assert load("rough.toml").content_hash("default") != before  # the base is a part of it
    Path("metro.toml").write_text('name = "m"\nbase = "ningbo-metro/late"\n')
    assert load("metro.toml").variants.keys() == {"default"}
    assert load("metro.toml").variants["default"]["channel"] == {"kind": "delay", "steps": 1}
    assert not load("metro.toml").requested


def test_a_variant_over_another_is_as_if_it_were_written_out(railstate: Command) -> None:
    """Whole tables compared, through a file above and by name; what comes from where is shown."""
    Path("own.toml").write_text('''name = "own"
base = "ningbo-metro"
[variants.quiet]
base = "fault-outliers-05"
title = "Less of it"
faults = { outliers = { share = 0.01 } }
[variants.later]
base = "late-random"
default = true
''')
    own, metro = load("own.toml"), load("ningbo-metro")
    fault, quiet, later = (own.variants[name] for name in ("fault-outliers-05", "quiet", "later"))
    assert fault == own.variants["gaussian"] | {key: fault[key] for key in ("title", "default", "faults")}
    assert quiet == fault | {"title": "Less of it", "faults": [fault["faults"][0] | {"share": 0.01}]}
    assert later == own.variants["late-random"] | {"default": True} and "quiet" in own.requested - {"later"}
    assert later["channel"]["steps"] == [1, 5] and later["estimators"]["ekf-rewind"]["default"]
    Path("above.toml").write_text('name = "above"\nbase = "own.toml/quiet"\n')
    alone = load("above.toml").variants["default"]
    assert alone["faults"] == quiet["faults"] and alone["estimators"] == quiet["estimators"]
    assert metro.variants["fault-outliers-05"]["estimators"]["ekf-tuned"]["tuned"]["variant"] == "gaussian"
    lines = {line.split()[0]: line for line in railstate("show", "own.toml/quiet").out.splitlines() if line.strip()}
    assert "ningbo-metro/g" in lines["sensors.noise"]


@pytest.mark.parametrize(("text", "expected"), [
    ('name = "a"\nbase = "cart.toml"\n[variants.rough]\nbase = "calmer"\n',
     'a.toml: variants.rough: base: must be another variant of this scenario (got \'calmer\'); allowed: calm'),
    ('name = "a"\nbase = "cart.toml"\n[variants.calm]\nbase = "rough"\n[variants.rough]\nbase = "calm"\n',
     "a.toml: variants.rough: base: leads back to itself: calm -> rough -> calm"),
    ('name = "a"\nbase = "cart.toml"\n[variants.calm]\nbase = 3\n', "variants.calm: base: must be another variant"),
    ('name = "a"\nbase = "ningbo"\n', 'a.toml: base: ningbo: no such scenario and no such file'),
    ('name = "a"\nbase = "ningbo-metro/whit"\n', 'a.toml: base: ningbo-metro has no variant "whit"; allowed: '),
    ('name = "a"\nbase = 3\n', "a.toml: base: must be a scenario's name, NAME/VARIANT or the path"),
    ('name = "a"\nbase = "b.toml"\n', "a.toml: base: leads back to itself"),
    ('name = "a"\nbase = "b.toml/x"\n', "base: leads back to itself"),
    ('base = "ningbo-metro"\n', "a.toml: name: missing"),
    ('name = "a"\nbase = "ningbo-metro"\n[disturbance]\nw_bar = -1\n', "a.toml: disturbance.w_bar: "),
    ('name = "a"\nbase = "bad.toml"\n', "a.toml: base bad.toml: variants.calm: channel.p: "),
    ('name = "a"\nbase = "cart.toml"\n[channel]\nq = 1\n', "a.toml: variants.calm: channel.q: unknown key"),
    ('name = "a"\nbase = "cart.toml"\n[origin]\n"plant.mass" = "x"\n', "a.toml: origin.plant.mass: names no key")])
def test_a_bad_base_is_told_with_the_file_that_is_wrong(railstate: Command, text: str, expected: str) -> None:
    Path("a.toml").write_text(text)
    Path("b.toml").write_text('name = "b"\nbase = "a.toml/y"\n')
    Path("bad.toml").write_text(SCENARIO.replace("p = 0.8", "p = 1.8"))
    done = railstate("show", "a.toml")
    assert done.code == 2 and done.err.startswith("error: ") and expected in done.err, done.err


def test_every_key_says_what_it_is_and_in_which_unit(railstate: Command) -> None:
    for kind, setting in settings().items():
        for key in keys_of(setting.Config):
            assert key.what, f"{kind}: {key.path} ({key.of}) has no description"
            assert key.unit or not key.numeric, f"{kind}: {key.path} ({key.of}) has no unit"
    said = " ".join(railstate("show", "ningbo-metro", "--keys").out.split())
    assert "disturbance.w_bar bound [m/s^2] required" in said and "[faults] of outliers" in said
    schema = json.loads(railstate("schema").out)
    time = schema["$defs"]["metro.Time"]["properties"]["period"]
    assert time["description"] == "sampling period [s]" and time["unit"] == "s"
    assert "description" in schema["$defs"]["metro"]["properties"]["base"]


def test_a_key_shows_its_unit_in_brackets_once() -> None:
    found = [strict.key("length", *unit) for unit in ((), ("1",), ("m",), ("[m, s]",))]
    assert [(one.description, one.json_schema_extra) for one in found] == [
        ("length", None), ("length", {"unit": "1"}), ("length [m]", {"unit": "m"}),
        ("length [m, s]", {"unit": "[m, s]"})]


def bounded(part: Any) -> Iterator[tuple[int | None, int]]:
    """(least, most) number of items of each array in a JSON schema that has a most."""
    if isinstance(part, dict) and part.get("type") == "array" and "maxItems" in part:
        yield part.get("minItems"), part["maxItems"]
    for inner in part.values() if isinstance(part, dict) else part if isinstance(part, list) else ():
        yield from bounded(inner)


@pytest.mark.parametrize("kind", sorted(settings()))
def test_pairs_and_triples_are_just_that(kind: str) -> None:
    found = list(bounded(settings()[kind].Config.model_json_schema()))
    assert all(least == most for least, most in found) and (found or kind == "linear")
