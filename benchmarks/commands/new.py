"""`railstate new estimator|scenario NAME`: a package that works at once, from the templates beside the command line.

`railstate new recording`, `new line`: small recordings, a line and a train to try settings with."""

from __future__ import annotations

import ast
import keyword
import re
import sys
from importlib.metadata import packages_distributions
from importlib.resources import files
from pathlib import Path
from typing import Annotated

import typer
from jinja2 import Environment, StrictUndefined

from ...estimators.registry import estimators, installed
from ...scenarios.errors import InputError
from ...scenarios.registry import scenario_files, settings

app = typer.Typer(no_args_is_help=True, help="Write a package for an estimator or a scenario, or examples to try.")
Name = Annotated[str, typer.Argument(help="Small letters, digits and hyphens, such as my-filter.")]
Under = Annotated[Path, typer.Option("--in", metavar="FOLDER", help="Where the package's folder is made.")]

ESTIMATOR = {"pyproject": "pyproject.toml", "readme": "README.md", "module": "{module}.py",
             "test": "tests/test_{module}.py"}
SCENARIO = {**ESTIMATOR, "module": "{module}/__init__.py", "toml": "{module}/{name}.toml"}


@app.command()
def estimator(name: Name, folder: Under = Path()) -> None:
    """A package with an estimator of twenty lines, its parameters, a test, a README and an entry point."""
    made = _write("estimator", ESTIMATOR, name, {*estimators(), *installed()}, folder)
    print(f"{made}: written; now\n  pip install -e {made}\n  railstate check {name}\n"
          f"  railstate run rap-example-1 --estimators {name},kalman")


@app.command()
def scenario(name: Name, folder: Under = Path()) -> None:
    """A package with a setting (simulation and design model), its TOML file, a test, a README and an entry point."""
    made = _write("scenario", SCENARIO, name, {*settings(), *scenario_files()}, folder)
    print(f"{made}: written; now\n  pip install -e {made}\n  railstate run {name}")


@app.command()
def recording(folder: Under = Path()) -> None:
    """Recordings of the suite's own making: a tram's trip, a receiver's fixes with the line they run along, a train's
    odometry with its balises."""
    written = _examples("railstate.scenarios.recorded", folder)
    print(f"{', '.join(map(str, written))}: written; now\n"
          f"  railstate inspect {folder / 'tram.csv'}\n"
          f"  railstate inspect {folder / 'fixes.csv'} --track {folder / 'track.geojson'}\n"
          f"  railstate inspect {folder / 'metro.csv'} --balises {folder / 'balises.csv'}")


@app.command()
def line(folder: Under = Path()) -> None:
    """A line and a train of the suite's own making, in TTOBench's JSON, to change."""
    written = _examples("railstate.scenarios.railway", folder)
    print(f"{', '.join(map(str, written))}: written; now\n"
          f"  railstate run ningbo-metro/switching --line {folder / 'track.json'} --train {folder / 'train.json'}")


def _examples(package: str, folder: Path) -> list[Path]:
    """Copy a package's examples. Raises InputError where there is no such folder, or one is there already."""
    if not folder.is_dir():
        raise InputError(f"--in {folder}: no such folder")
    examples = sorted((files(package) / "examples").iterdir(), key=lambda item: item.name)
    there = [item.name for item in examples if (folder / item.name).exists()]
    if there:
        raise InputError(f"{folder / there[0]}: exists already; choose another folder (--in FOLDER)")
    for item in examples:
        (folder / item.name).write_bytes(item.read_bytes())
    return [folder / item.name for item in examples]


def _write(kind: str, layout: dict[str, str], name: str, taken: set[str], under: Path) -> Path:
    """Render a kind's templates into under/NAME. Raises InputError for a bad or taken name or an existing folder."""
    module = name.replace("-", "_")
    if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", name) or keyword.iskeyword(module):
        raise InputError(f"{name}: not a name for {kind}s; allowed: small letters, digits and hyphens, beginning "
                         "with a letter, no word of Python, such as my-filter")
    if name in taken:
        raise InputError(f"{name}: there is such {'an' if kind == 'estimator' else 'a'} {kind} already; taken: "
                         f"{', '.join(sorted(taken))}")
    if module in sys.stdlib_module_names or module in packages_distributions():
        raise InputError(f"{name}: the Python module {module} is installed already; choose another name")
    if not under.is_dir():
        raise InputError(f"--in {under}: no such folder")
    folder = under / name
    if folder.exists():
        raise InputError(f"{folder}: exists already; choose another name or another folder (--in FOLDER)")
    environment = Environment(undefined=StrictUndefined, keep_trailing_newline=True, autoescape=False)
    words = {"name": name, "module": module, "cls": "".join(part.capitalize() for part in name.split("-"))}
    made: dict[Path, str] = {}
    for template, place in layout.items():
        text = (files("railstate.benchmarks.templates") / f"{kind}_{template}.jinja").read_text(encoding="utf-8")
        made[folder / place.format(**words)] = environment.from_string(text).render(words)
    for path, text in made.items():
        if path.suffix == ".py" and _unsound(text):
            raise InputError(f"{name}: not a name for {kind}s: the class {words['cls']} would be no Python, or hide "
                             "one that it needs; choose another, such as my-filter")
    for path, text in made.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return folder


def _unsound(text: str) -> bool:
    """Whether a module does not compile, or gives a name twice at its top: an import that a class hides."""
    try:
        body = ast.parse(text).body
    except SyntaxError:
        return True
    names = [alias.asname or alias.name for part in body if isinstance(part, ast.Import | ast.ImportFrom)
             for alias in part.names]
    names += [part.name for part in body if isinstance(part, ast.ClassDef | ast.FunctionDef)]
    return len(names) > len(set(names))
