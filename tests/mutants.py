"""What `mutate.py` changes in a module: operators, comparisons, numbers, truth values, statements, arguments."""

from __future__ import annotations

import ast
import random
import re
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

PACKAGES = ("benchmarks", "estimators", "scenarios")
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
