"""`railstate inspect FILE`: what is in a recording, a mapping to start from, and what cannot be.

The same checks run before a run; here all that they find is printed."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import ValidationError

from ...scenarios.errors import InputError, describe
from ...scenarios.files import load
from ...scenarios.recorded.config import Plant
from ...scenarios.recorded.findings import Finding
from ...scenarios.recorded.inspecting import Mapping, described, suggested
from ...scenarios.recorded.recording import Recording, read_recording, table_at
from ...scenarios.registry import scenario_files
from ..telling.console import print_table
from . import options as use


def inspect(
    file: Annotated[str, typer.Argument(help="A recorded trip: CSV, Parquet, GPX, NMEA, MCAP, rosbag2, MF4.")],
    map_: use.Map = "",
    quality: use.Quality = "",
    missing: use.Missing = "",
    track: use.Track = "",
    balises: use.Balises = "",
    from_: use.From = None,
    to: use.To = None,
    without: use.Without = [],  # noqa: B006
    set_: use.Sets = [],  # noqa: B006
    out: Annotated[str, typer.Option(metavar="FILE.toml", help="Write the scenario with this recording in it: to run, "
                                                               "sweep and tune.")] = "",
) -> None:
    """Say what is in a recorded trip, map it, and check it as a run would."""
    given = use.meaning(map_, quality, missing, track, balises, from_, to, without)
    given = {key.removeprefix("plant."): value for key, value in {**given, **use.overrides(set_)}.items()}
    try:
        table = table_at(file)
        found = suggested(table, "balises" in given)
    except ValueError as error:
        raise InputError(str(error)) from None
    if "map" in given:
        found = Mapping(given["map"], given.get("quality", {}), {})
    given = {**({"quality": found.quality} if found.quality else {}), **given, "map": found.map}
    print(f"{file}: {table.rows} rows of {len(table.names)} columns, {table.said}")
    print_table("", described(table, found.map.get("time", "")))
    print(f"\nA mapping to {'start from' if found.why or not map_ else 'run'}:\n\n{_toml(given, found)}")
    plant = _plant(file, given)
    wrong: list[str] = []
    recording = _recording(file, plant, wrong)
    if recording is not None:
        for line in (*recording.said, f"reference: {recording.reference}"):
            print(line)
        print(f"{len(recording.time)} rows of {recording.time[-1] - recording.time[0]:.6g} s, "
              f"{recording.position.max() - recording.position.min():.6g} m, up to {recording.speed.max():.4g} m/s")
        wrong += [item.text for item in recording.findings if item.grade == "impossible"]
        _say("Odd", [item for item in recording.findings if item.grade == "odd"])
    print("\nWhat cannot be:" if wrong else "\nNothing that cannot be.")
    for text in wrong:
        print(f"- {text}")
    print(f"\n{_command(file, given)}")
    if out and not wrong:
        _write(out, file, given, found)
    if wrong:
        raise typer.Exit(1)


def _plant(file: str, given: dict[str, Any]) -> Plant:
    """The scenario's table for the recording, which is read apart. Raises InputError."""
    try:
        return Plant.model_validate({"kind": "recorded", **given})
    except ValidationError as error:
        raise InputError("\n".join(describe(error, Plant, file))) from None


def _recording(file: str, plant: Plant, wrong: list[str]) -> Recording | None:
    """The recording as mapped; where its rows are not in order, what else there is after sorting them."""
    try:
        return read_recording(file, plant.meaning)
    except ValueError as error:
        wrong.append(str(error).removeprefix(f"{file}: "))
    if "time must increase" not in wrong[0]:
        return None
    try:
        return read_recording(file, plant.model_copy(update={"order": "sort", "duplicates": "first"}).meaning)
    except ValueError as error:
        wrong.append(str(error).removeprefix(f"{file}: "))
        return None


def _say(title: str, findings: list[Finding]) -> None:
    if findings:
        print(f"\n{title}:")
        for item in findings:
            print(f"- {item.text}")


def _toml(given: dict[str, Any], found: Mapping) -> str:
    """The mapping as the scenario file has it."""
    lines = ["[plant]"]
    for key, value in given.items():
        if key == "quality":
            value = "{ " + ", ".join(f"{json.dumps(name)} = {json.dumps(sd)}" for name, sd in value.items()) + " }"
            lines.append(f"quality = {value}")
        elif key != "map":
            lines.append(f"{key} = {json.dumps(value)}")
    lines += ["", "[plant.map]"]
    for role, text in found.map.items():
        lines.append(f"{role} = {json.dumps(text, ensure_ascii=False)}" + (f" # {found.why[role]}" if role in found.why
                                                                          else ""))
    return "\n".join(lines) + "\n"


def _scenario(given: dict[str, Any]) -> str:
    """The built-in scenario for what is mapped."""
    return "recorded-odometry" if {"wheel-a", "wheel-b"} & set(given["map"]) else "recorded"


def _write(out: str, file: str, given: dict[str, Any], found: Mapping) -> None:
    """The built-in scenario as a file of its own, with this recording, without variants that do not fit it. Raises
    InputError."""
    given = {"recording": str(Path(file).resolve()), **given}
    unfit = load(_scenario(given), {f"plant.{key}": value for key, value in given.items()}).unfit
    text = scenario_files()[_scenario(given)].read_text(encoding="utf-8")
    plant = _toml({"kind": "recorded", **given}, found)
    name = re.sub(r"[^A-Za-z0-9._-]+", "-", Path(out).stem)
    for variant in unfit:
        text = re.sub(rf"(?ms)^\[variants\.{re.escape(variant)}\]\n.*?(?=^\[)", "", text)
    text = re.sub(r'(?m)^name = .*$', f"name = {json.dumps(name)}", text, count=1)
    text = re.sub(r'(?m)^\[plant\]\nkind = .*$', lambda _: plant.rstrip(), text, count=1)
    with use.written("--out", out):
        Path(out).write_text(text, encoding="utf-8")
    print(f"railstate run {out}" + "".join(f"\n{variant}: left out: {why[0]}" for variant, why in unfit.items()))


def _command(file: str, given: dict[str, Any]) -> str:
    """The command that runs the recorded scenario on it."""
    words = ["railstate", "run", _scenario(given), "--recording", file, "--map",
             ",".join(f"{role}={text}" for role, text in given["map"].items())]
    if given.get("quality"):
        words += ["--quality", ",".join(f"{name}={sd}" for name, sd in given["quality"].items())]
    if given.get("missing"):
        words += ["--missing", ",".join(str(value) for value in given["missing"])]
    for key in ("track", "balises"):
        if isinstance(given.get(key), str):
            words += [f"--{key}", given[key]]
    if given.get("span"):
        words += ["--from", f"{given['span'][0]:g}", "--to", f"{given['span'][1]:g}"]
    for begin, end in given.get("without", []):
        words += ["--without", f"{begin:g}..{end:g}"]
    for key in ("order", "duplicates", "wrap"):
        if key in given:
            words += ["--set", f"plant.{key}={given[key]}"]
    return shlex.join(words)
