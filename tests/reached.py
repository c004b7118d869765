"""Which tests reach a line of the three packages, for `mutate.py`: written down by a plug-in of pytest, read back.

Lines move as files are edited: what was written down keeps the text it was measured on."""

from __future__ import annotations

import ast
import difflib
import json
import os
import re
import time
from bisect import bisect_right
from collections.abc import Collection, Iterable
from functools import cache
from itertools import accumulate, chain
from pathlib import Path
from typing import Any

from mutants import PACKAGES, Fault

WHOLE = re.compile(r"^def (test_\w+)\([^)]*\bexpected: (?:Expected|Callable\[\[str, str\], None\])", re.MULTILINE)
"""Tests that compare whole outputs: asked however long they take, those with cases as others are."""
IMPORT = re.compile(r"^from railstate[\w.]* import (?:\([^)]*\)|.*)", re.MULTILINE)
APART = re.compile(r"\b(subprocess|Popen|Fresh|fork|isolation|isolated|jobs|half)\b")
"""Words of tests that start processes, such as those of plug-ins: nothing is seen of what is reached there."""
LOADING = "tests/test_defaults.py::test_defaults_and_constants"
"""Looks at all that is made as modules are loaded."""
SETS_OUT = "short_runs"
"""In the names of those that share runs which take long to set out: asked last."""


def texts(tree: Path) -> dict[str, str]:
    """The modules of the three packages."""
    return {str(path.relative_to(tree)): path.read_text(encoding="utf-8") for package in PACKAGES
            for path in (tree / package).rglob("*.py")}


class Reach:
    """A plug-in of pytest that writes down the lines each test reaches, and how long it takes; begun in the child."""

    def __init__(self, tree: Path, out: Path) -> None:
        self.tree, self.out, self.saved = tree, out, time.monotonic()
        self.seconds, self.failed = dict[str, float](), set[str]()

    def pytest_configure(self) -> None:
        import coverage

        self.coverage = coverage.Coverage(data_file=None, include=[f"{self.tree}/{name}/*" for name in PACKAGES],
                                          messages=False, config_file=False)
        self.coverage.start()

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.coverage.switch_context(nodeid)
        self.seconds[nodeid] = time.monotonic()

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed:
            self.failed.add(report.nodeid)

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        self.seconds[nodeid] = time.monotonic() - self.seconds[nodeid]
        if time.monotonic() > self.saved + 120:
            self.pytest_sessionfinish()

    def pytest_sessionfinish(self) -> None:
        """Write down what is known, from time to time and in the end."""
        self.saved = time.monotonic()
        data, lines, text = self.coverage.get_data(), {}, texts(self.tree)
        names = sorted(set(self.seconds) - self.failed)
        places = {name: number for number, name in enumerate(names)}
        for file in data.measured_files():
            lines[str(Path(file).relative_to(self.tree))] = {
                line: sorted(places[name] for name in contexts if name in places)
                for line, contexts in data.contexts_by_lineno(file).items()}
        self.out.write_text(json.dumps({"tests": [[name, self.seconds[name]] for name in names], "lines": lines,
                                        "failed": sorted(self.failed), "text": {name: text[name] for name in lines}}))


class Tests:
    """What `Reach` has written down: which tests reach a line, and how long each takes. What failed there, without a
    fault, is asked nothing."""

    def __init__(self, folder: Path, tree: Path, there: Collection[str]) -> None:
        self.tree, self.text, self.names = tree, texts(tree), list[str]()
        self.trees = {path: ast.parse(text) for path, text in self.text.items()}
        sources = {str(path.relative_to(tree)): path.read_text(encoding="utf-8")
                   for path in (tree / "tests").rglob("test_*.py")}
        self.whole = {f"{path}::{name}" for path, text in sources.items() for name in WHOLE.findall(text)}
        self.seconds, failed = list[float](), set[str]()
        self.lines: dict[str, dict[int, set[int]]] = {}
        for path in sorted((folder / "home").glob("reach*.json")):
            found, before = json.loads(path.read_text()), len(self.names)
            failed.update(found["failed"])
            self.names += [name for name, _ in found["tests"]]
            self.seconds += [seconds for _, seconds in found["tests"]]
            gone = {number for number, (name, _) in enumerate(found["tests"]) if name not in there}
            for file, lines in found["lines"].items():
                now, mine = moved(found["text"][file], self.text.get(file, "")), self.lines.setdefault(file, {})
                for line, numbers in lines.items():
                    if (place := now.get(int(line))) is not None:
                        mine.setdefault(place, set()).update(number + before for number in set(numbers) - gone)
        failed -= set(self.names)
        self.there = set(there) - failed
        self._beside(sources, {name.partition("[")[0] for name in failed.union(self.names)})

    def _beside(self, sources: dict[str, str], known: set[str]) -> None:
        """Which words stand in each test and in what it calls of its file, and tests of which nothing is written down,
        with what their files import."""
        self.words: dict[str, set[str]] = {}
        self.imports: dict[str, str] = {}
        self.unknown = set[str]()
        self.apart = set[str]()
        for path, text in sources.items():
            self.imports[path] = " ".join(IMPORT.findall(text))
            functions = {node.name: node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef)}
            words = {name: {getattr(part, "attr", getattr(part, "id", getattr(part, "arg", "")))
                            for part in ast.walk(node)} for name, node in functions.items()}
            apart = {name for name, node in functions.items() if APART.search(ast.unparse(node))}
            for name in filter(re.compile("test_").match, functions):
                own = words[name]
                for _ in range(3):
                    own = own.union(*(words[word] for word in own if word in words))
                self.words[f"{path}::{name}"] = own
                if apart & {name, *own}:
                    self.apart.add(f"{path}::{name}")
                if f"{path}::{name}" not in known and "long" not in own:
                    self.unknown.add(f"{path}::{name}")

    def of(self, fault: Fault, most: float) -> list[str]:
        """Those that reach a fault: its statement, the users of what it makes, its module, its package. Those of files
        that import the module first, then quick ones, as many as take so many seconds, and the whole outputs."""
        seconds = {self.names[number]: self.seconds[number] for number in self._reaching(fault)}
        folder, stem = fault.path.removesuffix(".py").replace("/", ".").rpartition(".")[::2]
        module = re.compile(rf"railstate\.{folder}(\.{stem} import| import .*\b{stem}\b)")
        by_name = {path for path, imports in self.imports.items() if module.search(imports)}
        seconds |= {name: 1.0 for name in self.unknown if name.partition("::")[0] in by_name}
        ordered = sorted(seconds, key=lambda name: (
            SETS_OUT in name, name != LOADING, name.partition("::")[0] not in by_name, seconds[name]))
        rest = [name for name in ordered if name not in self.whole]
        room = bisect_right(list(accumulate(map(seconds.__getitem__, rest))), most)
        taken = {*rest[:max(room, 1)], *(name for name in ordered if name in self.whole)}
        return [name for name in ordered if name in taken]

    def beyond(self, fault: Fault, asked: list[str], most: float) -> list[str]:
        """What else may see a fault, quick ones first: for half of so many seconds those that reach it, then those that
        name its function or class, those that start processes, and those that reach its module."""
        named = {node.name for node in self._around(fault) if isinstance(node, ast.FunctionDef | ast.ClassDef)}
        tiers = ((0.5, [self.names[number] for number in self._reaching(fault)]),
                 (0.6, [name for name in self.there if self.words.get(name.partition("[")[0], set()) & named]),
                 (0.8, [name for name in self.there if name.partition("[")[0] in self.apart]),
                 (1.0, [self.names[number] for number in self._within(fault.path)]))
        seconds, out, spent = dict(zip(self.names, self.seconds, strict=True)), list[str](), 0.0
        for share, names in tiers:
            for name in sorted(set(names).difference(asked, out), key=lambda name: seconds.get(name, 1.0)):
                if spent + seconds.get(name, 1.0) > share * most:
                    break
                spent += seconds.get(name, 1.0)
                out.append(name)
        return out

    def _reaching(self, fault: Fault) -> set[int]:
        folder = os.path.dirname(fault.path)
        return self._statement(fault) or self._within(fault.path) or set().union(
            *(self._within(path) for path in self.text if os.path.dirname(path) == folder))

    def _at(self, path: str, lines: Iterable[int]) -> set[int]:
        mine = self.lines.get(path, {})
        return set().union(*(mine.get(line, set()) for line in lines))

    def _within(self, path: str) -> set[int]:
        """Tests that reach a function of a module: its other lines are reached by whoever loads it first."""
        return set().union(*(self._at(path, range(node.body[0].lineno, (node.end_lineno or 0) + 1))
                             for node in ast.walk(ast.parse(self.text[path])) if isinstance(node, ast.FunctionDef)))

    def _loading(self) -> set[int]:
        return {number for number, name in enumerate(self.names) if name == LOADING}

    def _around(self, fault: Fault) -> list[ast.stmt]:
        """The statements around a fault, the outermost first."""
        around, body = list[ast.stmt](), self.trees[fault.path].body
        while inner := next((node for node in body if _first(node) <= fault.line <= (node.end_lineno or 0)), None):
            around.append(inner)
            body = _parts(inner)
        return around

    def _statement(self, fault: Fault) -> set[int]:
        """Tests that reach the statement around a fault. What is done as a module is loaded, compiled, or done in other
        processes is reached by those of the lines that name what it makes."""
        around, at = self._around(fault), fault.line
        if not around:
            return set()
        last, functions = around[-1], [node for node in around if isinstance(node, ast.FunctionDef)]
        if functions:
            begin, end = functions[-1].body[0].lineno, functions[-1].end_lineno or 0
            if begin <= at:
                return self._at(fault.path, _range(last)) or self._users({functions[0].name})
            return self._loading() | (self._at(fault.path, range(begin, end + 1)) or self._users({functions[0].name}))
        names = {node.id for node in ast.walk(last) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
        return self._loading() | self._users(names) | self._within(fault.path)

    def _users(self, names: set[str]) -> set[int]:
        """Tests that name something, and of the lines of functions that do, or of what in compiled code calls it."""
        found = set[int]()
        for _ in range(4):
            word = re.compile(rf"\b({'|'.join(map(re.escape, names))})\b") if names else None
            if word is None:
                break
            more = set[str]()
            for path, text in self.text.items():
                if not word.search(text):
                    continue
                numbers = {number for number, line in enumerate(text.splitlines(), 1) if word.search(line)}
                for node in ast.walk(self.trees[path]):
                    if isinstance(node, ast.FunctionDef):
                        mine = numbers & set(range(node.lineno + 1, (node.end_lineno or 0) + 1))
                        more |= {node.name} if mine else set()
                        found |= set().union(*(self._at(path, range(number, number + 1)) for number in mine))
            if found or more <= names:
                break
            names = names | more
        return found | {number for number, name in enumerate(self.names)
                        if self.words.get(name.partition("[")[0], set()) & names}


@cache
def moved(old: str, new: str) -> dict[int, int]:
    """By line of the old text, which line of the new one it is now."""
    if old == new:
        return {number: number for number in range(1, old.count("\n") + 2)}
    blocks = difflib.SequenceMatcher(None, old.splitlines(), new.splitlines(), autojunk=False).get_matching_blocks()
    return dict(chain.from_iterable(((a + k + 1, b + k + 1) for k in range(size)) for a, b, size in blocks))


def _first(node: ast.stmt) -> int:
    return min([node.lineno, *(part.lineno for part in getattr(node, "decorator_list", []))])


def _parts(node: ast.stmt) -> list[ast.stmt]:
    """The statements directly inside another."""
    return [part for name in ("body", "orelse", "finalbody") for part in getattr(node, name, [])] + [
        part for inner in (*getattr(node, "handlers", []), *getattr(node, "cases", [])) for part in inner.body]


def _range(node: ast.stmt) -> range:
    """The lines of a statement without those inside it."""
    begin, inside = _first(node), _parts(node)
    return range(begin, max(begin + 1, min(map(_first, inside))) if inside else (node.end_lineno or 0) + 1)
