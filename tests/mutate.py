"""Seeded faults in the three packages against the tests that reach their lines: run by hand, not by pytest.

`python tests/mutate.py reach DIR [TEST..]`, then `python tests/mutate.py try DIR --seed 7`: in a copy of the tree in
DIR, as another user under limits (only root can), since a fault may loop or fork. `coverage` has to be installed."""

from __future__ import annotations

import argparse
import ast
import compileall
import hashlib
import importlib
import importlib.util
import json
import os
import random
import re
import resource
import shutil
import signal
import sys
import time
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("benchmarks", "estimators", "scenarios")
USER, PROCESSES, LARGEST = 47_029, 300, 12 << 30
"""Who runs the tests, and how many processes and bytes of address space that user gets."""
PRELOADED = ("numba", "pandas", "pyarrow.parquet", "pyarrow.compute", "scipy.linalg", "scipy.stats", "scipy.integrate",
             "scipy.optimize", "scipy.signal", "matplotlib.pyplot", "pydantic", "typer", "rich.console",
             "rich.progress", "jinja2", "joblib", "cvxpy", "hypothesis", "pytest", "threadpoolctl", "filterpy.kalman")
"""What a trial need not import anew: libraries, nothing of ours."""
JIT = re.compile(r"^ *@(njit|kernel|compiled)\b|\bcompiled\(", re.MULTILINE)
SWAPS = {ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"), ast.FloorDiv: ("//", "*"),
         ast.Mod: ("%", "*"), ast.Pow: ("**", "*"), ast.Lt: ("<", "<="), ast.LtE: ("<=", "<"), ast.Gt: (">", ">="),
         ast.GtE: (">=", ">"), ast.Eq: ("==", "!="), ast.NotEq: ("!=", "=="), ast.And: ("and", "or"),
         ast.Or: ("or", "and"), ast.In: ("in", "not in"), ast.NotIn: ("not in", "in"), ast.Is: ("is", "is not"),
         ast.IsNot: ("is not", "is"), ast.BitAnd: ("&", "|"), ast.BitOr: ("|", "&")}


class Fault(NamedTuple):
    """A change of a module: what stands at [begin, end) of its text becomes `new`."""

    path: str
    line: int
    begin: int
    end: int
    new: str


class Draw(ast.NodeVisitor):
    """All faults of a module: operators, comparisons, numbers, truth values, deleted statements, dropped arguments."""

    def __init__(self, path: str, text: str) -> None:
        self.path, self.text, self.found = path, text, list[Fault]()
        data = text.encode()  # columns of a tree count bytes
        self.starts = [0]
        for line in data.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(line))
        self.data = data
        self.visit(ast.parse(text))

    def add(self, line: int, begin: int, end: int, new: str) -> None:
        begin, end = (len(self.data[:place].decode()) for place in (begin, end))
        self.found.append(Fault(self.path, line, begin, end, new))

    def first(self, node: Any) -> int:
        return self.starts[node.lineno - 1] + node.col_offset

    def last(self, node: Any) -> int:
        return self.starts[node.end_lineno - 1] + node.end_col_offset

    def swap(self, left: Any, operator: Any, right: Any, tail: str = "") -> None:
        """The operator's sign between two nodes."""
        if type(operator) not in SWAPS:
            return
        old, new = SWAPS[type(operator)]
        begin, end = self.last(left), self.first(right)
        place = re.search((rf"\b{old}\b" if old.isalpha() else re.escape(old + tail)).encode(), self.data[begin:end])
        if place:
            self.add(left.end_lineno, begin + place.start(), begin + place.end(), new + tail)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        if not isinstance(node.left, ast.Constant) or not isinstance(node.left.value, str):
            self.swap(node.left, node.op, node.right)
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        self.swap(node.target, node.op, node.value, "=")
        self.gone(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        for left, operator, right in zip([node.left, *node.comparators], node.ops, node.comparators, strict=False):
            self.swap(left, operator, right)
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        self.swap(node.values[0], node.op, node.values[1])
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if isinstance(node.op, ast.Not | ast.USub):
            self.add(node.lineno, self.first(node), self.first(node.operand), "")
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        value: Any = node.value
        if isinstance(value, int | float) and value == value:
            new = not value if isinstance(value, bool) else value + 1 if isinstance(value, int) else value * 1.5 or 1.0
            self.add(node.lineno, self.first(node), self.last(node), repr(new))

    def visit_Call(self, node: ast.Call) -> None:
        for word in node.keywords:
            end = self.last(word)
            if word.arg and self.data[end:end + 1] == b",":
                self.add(word.lineno, self.first(word), end + 1, "")
            elif word.arg:
                begin = self.first(word)
                before = self.data[:begin].rstrip()
                self.add(word.lineno, len(before) - before.endswith(b","), end, "")
        self.generic_visit(node)

    def gone(self, node: Any) -> None:
        """A statement that is left out."""
        self.add(node.lineno, self.first(node), self.last(node), "pass")
        self.generic_visit(node)

    visit_Raise = visit_Continue = visit_Break = gone

    def visit_If(self, node: ast.If) -> None:
        if "TYPE_CHECKING" in ast.dump(node.test):
            return
        if not node.orelse and self.text.splitlines()[node.lineno - 1].lstrip().startswith("if"):
            self.add(node.lineno, self.first(node), self.last(node), "pass")
        self.generic_visit(node)

    def visit_Expr(self, node: ast.Expr) -> None:
        if isinstance(node.value, ast.Call):
            self.gone(node)
        elif not isinstance(node.value, ast.Constant):
            self.generic_visit(node)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        for child in [*node.args.defaults, *filter(None, node.args.kw_defaults), *node.body]:
            self.visit(child)

    def visit_Import(self, node: ast.Import) -> None:
        """Nothing to change."""


def modules(tree: Path) -> list[str]:
    """The modules of the three packages that have something to change."""
    return [str(path.relative_to(tree)) for package in PACKAGES for path in sorted((tree / package).rglob("*.py"))
            if len(Draw("", path.read_text(encoding="utf-8")).found) >= 4]


def copied(folder: Path) -> Path:
    """The tree in `folder`, importable from there as `railstate`."""
    tree = folder / "tree"
    if not tree.exists():
        shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(".git", "__pycache__", "*.egg-info", ".venv"))
        (tree / "railstate").mkdir()
        for package in PACKAGES:
            (tree / "railstate" / package).symlink_to(Path("..") / package)
            compileall.compile_dir(str(tree / "railstate" / package), quiet=1)
        for path in [tree / "tests", *(tree / "tests").iterdir()]:
            if path.is_dir():
                (path / "__pycache__").mkdir(exist_ok=True)
                os.chown(path / "__pycache__", USER, USER)
    for name in ("cache", "home"):
        (folder / name).mkdir(exist_ok=True)
        os.chown(folder / name, USER, USER)
    return tree


def child(folder: Path, tree: Path, cache: Path, words: list[str], log: Path, plugins: list[Any]) -> int:
    """Fork a process that runs pytest as the other user."""
    pid = os.fork()
    if pid:
        return pid
    code = 99
    try:
        os.setsid()
        handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
        for number in (1, 2):
            os.dup2(handle, number)
        resource.setrlimit(resource.RLIMIT_NPROC, (PROCESSES, PROCESSES))
        resource.setrlimit(resource.RLIMIT_AS, (LARGEST, LARGEST))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        os.setgroups([])
        os.setgid(USER)
        os.setuid(USER)
        os.environ.update(HOME=str(folder / "home"), TMPDIR=str(folder / "home"), NUMBA_CACHE_DIR=str(cache),
                          PYTHONPATH=str(tree))
        os.chdir(tree)
        sys.path.insert(0, str(tree))
        sys.modules["numba"].config.CACHE_DIR = str(cache)
        import pytest

        code = int(pytest.main(["-n", "0", "--dist", "no", "-p", "no:cacheprovider", "--timeout", "120", *words],
                               plugins=plugins))
    finally:
        sys.stdout.flush()
        os._exit(code)


def ended(pid: int, seconds: float) -> int | None:
    """How a child ended; None: not in time. All that its user has started is ended."""
    until, status = time.monotonic() + seconds, 0
    while (done := os.waitpid(pid, os.WNOHANG))[0] == 0 and time.monotonic() < until:
        time.sleep(0.05)
    status = os.waitstatus_to_exitcode(done[1]) if done[0] else None
    for _ in range(20):
        left = [number for number in map(int, filter(str.isdecimal, os.listdir("/proc"))) if _owner(number) == USER]
        for number in left:
            with suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)
        with suppress(ChildProcessError):
            os.waitpid(pid, os.WNOHANG)
        if not left:
            break
        time.sleep(0.1)
    return status


def _owner(number: int) -> int:
    try:
        return os.stat(f"/proc/{number}").st_uid
    except OSError:
        return -1


class Reach:
    """A plug-in of pytest that writes down the lines each test reaches, and how long it takes."""

    def __init__(self, tree: Path, out: Path) -> None:
        import coverage

        self.out, self.seconds, self.failed = out, dict[str, float](), set[str]()
        self.tree, self.saved = tree, time.monotonic()
        self.coverage = coverage.Coverage(data_file=None, include=[f"{tree}/{name}/*" for name in PACKAGES],
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
        data = self.coverage.get_data()
        names = sorted(set(self.seconds) - self.failed)
        places = {name: number for number, name in enumerate(names)}
        lines = {}
        for file in data.measured_files():
            found = {line: sorted(places[name] for name in contexts if name in places)
                     for line, contexts in data.contexts_by_lineno(file).items()}
            lines[str(Path(file).relative_to(self.tree))] = found
        self.out.write_text(json.dumps({"tests": [[name, self.seconds[name]] for name in names],
                                        "failed": sorted(self.failed), "lines": lines}))


class Tests:
    """What `reach` has written down: which tests reach a line, and how long each takes."""

    def __init__(self, folder: Path, tree: Path) -> None:
        self.tree, self.names = tree, list[str]()
        self.seconds: list[float] = []
        self.lines: dict[str, dict[int, set[int]]] = {}
        for path in sorted((folder / "home").glob("reach*.json")):
            found, before = json.loads(path.read_text()), len(self.names)
            self.names += [name for name, _ in found["tests"]]
            self.seconds += [seconds for _, seconds in found["tests"]]
            for file, lines in found["lines"].items():
                mine = self.lines.setdefault(file, {})
                for line, numbers in lines.items():
                    mine.setdefault(int(line), set()).update(number + before for number in numbers)
        self.text = {str(path.relative_to(tree)): path.read_text(encoding="utf-8") for package in PACKAGES
                     for path in (tree / package).rglob("*.py")}

    def of(self, fault: Fault, most: float) -> list[str]:
        """Those that reach a fault: its line, the callers of its compiled function, its module, its package; the quick
        ones first, as many as take so many seconds."""
        found = self._at(fault.path, range(fault.line, fault.line + 1)) or self._callers(fault) or self._at(fault.path)
        folder = os.path.dirname(fault.path)
        found = found or set().union(*(self._at(path) for path in self.lines if os.path.dirname(path) == folder))
        taken, spent = list[str](), 0.0
        for number in sorted(found, key=lambda number: self.seconds[number]):
            spent += self.seconds[number]
            if taken and spent > most:
                break
            taken.append(self.names[number])
        return taken

    def _at(self, path: str, lines: range | None = None) -> set[int]:
        mine = self.lines.get(path, {})
        return set().union(*(mine.get(line, set()) for line in (mine if lines is None else lines)))

    def _callers(self, fault: Fault) -> set[int]:
        """Tests of the lines of Python that name the compiled function around a fault, or one that calls it."""
        if not JIT.search(self.text[fault.path]):
            return set()
        around = [node.name for node in ast.walk(ast.parse(self.text[fault.path])) if isinstance(node, ast.FunctionDef)
                  and node.lineno <= fault.line <= (node.end_lineno or 0)]
        names, found = set(around[:1]), set[int]()
        for _ in range(4):
            word = re.compile(rf"\b({'|'.join(map(re.escape, names))})\b") if names else None
            if word is None:
                break
            more = set[str]()
            for path, text in self.text.items():
                if not word.search(text):
                    continue
                for node in ast.walk(ast.parse(text)):
                    if isinstance(node, ast.FunctionDef) and word.search(ast.get_source_segment(text, node) or ""):
                        more.add(node.name)
                        for number, line in enumerate(text.splitlines(), 1):
                            if node.lineno < number <= (node.end_lineno or 0) and word.search(line):
                                found |= self._at(path, range(number, number + 1))
            if found or more <= names:
                break
            names |= more
        return found


def drawn(tree: Path, seed: int, count: int, each: int) -> list[Fault]:
    """`each` faults of each of `count` modules."""
    rng, out = random.Random(seed), list[Fault]()
    for path in sorted(rng.sample(modules(tree), count)):
        text = (tree / path).read_text(encoding="utf-8")
        found = Draw(path, text).found
        sound = (fault for fault in rng.sample(found, len(found)) if _parses(text, fault))
        out += sorted(islice(sound, each))
    return out


def _parses(text: str, fault: Fault) -> bool:
    try:
        return ast.dump(ast.parse(text)) != ast.dump(ast.parse(text[:fault.begin] + fault.new + text[fault.end:]))
    except SyntaxError:
        return False


def attempt(folder: Path, tree: Path, options: argparse.Namespace) -> None:
    """Try drawn faults one after the other; a line of JSON each in tried.jsonl."""
    tests, faults = Tests(folder, tree), drawn(tree, options.seed, options.modules, options.each)
    only = set(map(int, options.only.split(","))) if options.only else set(range(len(faults)))
    done = folder / f"tried{options.name}.jsonl"
    for number, fault in enumerate(faults):
        if number not in only:
            continue
        chosen, text = tests.of(fault, options.seconds), tests.text[fault.path]
        place = tree / fault.path
        before = place.stat()
        begun, how = time.monotonic(), "no test reaches it"
        if chosen:
            place.write_text(text[:fault.begin] + fault.new + text[fault.end:], encoding="utf-8")
            cache = machine_code(folder, tree, fault)
            try:
                pid = child(folder, tree, cache, ["-x", *chosen], folder / "trial.log", [])
                code = ended(pid, 90 + 6 * options.seconds)
                how = {0: "survives", None: "caught: no end"}.get(code, "caught")
                if code not in (0, 1, None):
                    how = f"caught: pytest ends with {code}"
            finally:
                place.write_text(text, encoding="utf-8")
                os.utime(place, ns=(before.st_atime_ns, before.st_mtime_ns))
                if cache != folder / "cache":
                    shutil.rmtree(cache, ignore_errors=True)
        line = text.splitlines()[fault.line - 1].strip()
        log = (folder / "trial.log").read_text(errors="replace") if chosen else ""
        by = re.findall(r"^(?:FAILED|ERROR) (\S+)", log, re.MULTILINE)
        said = {"number": number, "how": how, "path": fault.path, "line": fault.line, "new": fault.new, "text": line,
                "old": text[fault.begin:fault.end][:80], "tests": len(chosen), "by": by[:1],
                "seconds": round(time.monotonic() - begun)}
        with done.open("a") as out:
            out.write(json.dumps(said) + "\n")
        print(f"{number} {how}: {fault.path}:{fault.line} {said['old'][:30]!r} -> {fault.new!r} ({len(chosen)} tests, "
              f"{said['seconds']:.0f} s)", flush=True)


def machine_code(folder: Path, tree: Path, fault: Fault) -> Path:
    """The place of numba's caches for a fault: what does not depend on it is there already."""
    sys.path.insert(0, str(ROOT))
    spec = importlib.util.spec_from_file_location("machine_code", tree / "scenarios" / "machine_code.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    packages = [tree / "railstate" / name for name in ("scenarios", "estimators", "benchmarks")]
    key = module.key(*packages)
    if (folder / "cache" / key).is_dir() and not JIT.search((tree / fault.path).read_text(encoding="utf-8")):
        return folder / "cache"
    newest = max((folder / "cache").iterdir(), key=lambda path: sum(1 for _ in path.rglob("*.nbc")))
    cache = folder / "home" / "cache-of-a-fault"
    shutil.rmtree(cache, ignore_errors=True)
    shutil.copytree(newest, cache / key)
    text = {path: path.read_text(encoding="utf-8") for package in packages for path in package.rglob("*.py")}
    stale = {tree / "railstate" / fault.path}
    inside = any(node.lineno <= fault.line <= (node.end_lineno or 0) for node in ast.walk(ast.parse(
        text[tree / "railstate" / fault.path])) if isinstance(node, ast.FunctionDef))
    if JIT.search(text[tree / "railstate" / fault.path]) or not inside:
        while more := {path for path, code in text.items() if path not in stale and JIT.search(code)
                       and stale.intersection(module._imported(path, code))}:
            stale |= more
    for path in stale:
        name = f"{path.parent.name}_{hashlib.sha1(str(path.parent).encode()).hexdigest()}"
        for file in (cache / key / name).glob(f"{path.stem}.*"):
            file.unlink()
    for path in [cache, *cache.rglob("*")]:
        os.chown(path, USER, USER)
    return cache


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["reach", "try"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("tests", nargs="*", default=["tests"])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--modules", type=int, default=50)
    parser.add_argument("--each", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=20.0, help="of tests a fault is tried against")
    parser.add_argument("--only", default="", help="numbers of the faults to try, 3,17,..")
    parser.add_argument("--name", default="", help="of the file of reach")
    options = parser.parse_intermixed_args()
    folder = options.folder.resolve()
    folder.mkdir(exist_ok=True, parents=True)
    os.environ.update({f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL")})
    os.environ.update(ARROW_DEFAULT_MEMORY_POOL="system")
    tree = copied(folder)
    for name in PRELOADED:
        importlib.import_module(name)
    if options.what == "reach":
        out = folder / "home" / f"reach{options.name}.json"
        pid = child(folder, tree, folder / "cache", options.tests, folder / f"reach{options.name}.log",
                    [Late(tree, out)])
        print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), out)
    else:
        attempt(folder, tree, options)


class Late:
    """`Reach`, made in the child."""

    def __init__(self, tree: Path, out: Path) -> None:
        self.given = tree, out

    def pytest_configure(self, config: Any) -> None:
        config.pluginmanager.register(Reach(*self.given))


if __name__ == "__main__":
    main()
