"""Matrix entries of scenario files as arithmetic in the step k, such as "0.95 + 0.05*sin(k)".

Text from a file never reaches Python's own evaluation: a whitelist of the syntax tree is walked, nothing else."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable
from functools import cache

Compiled = Callable[[int], float]

LONGEST = 200
CONSTANTS = {"pi": math.pi, "e": math.e}
FUNCTIONS: dict[str, Callable[[float], float]] = {
    "sin": math.sin, "cos": math.cos, "tan": math.tan, "tanh": math.tanh, "exp": math.exp, "log": math.log,
    "sqrt": math.sqrt, "abs": abs,
}
BINARY: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Pow: math.pow, ast.Mod: math.fmod,
}
ALLOWED = f"numbers, k, {', '.join(CONSTANTS)}, + - * / ** %, parentheses and {', '.join(FUNCTIONS)}"


@cache
def expression(text: str) -> Compiled:
    """The function of k that `text` describes. Raises ValueError naming what is not allowed.

    The function raises ValueError where it has no finite value (division by zero, overflow, log of nothing)."""
    if len(text) > LONGEST:
        raise ValueError(f"an expression of {len(text)} characters is too long; at most {LONGEST}")
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ValueError(f"\"{text}\" is not an expression; allowed: {ALLOWED}") from None
    inner = _compile(tree.body, text)

    def value(k: int) -> float:
        try:
            result = inner(k)
        except (ZeroDivisionError, OverflowError, ValueError):
            result = math.nan
        if not math.isfinite(result):
            raise ValueError(f"\"{text}\" has no finite value at k = {k}")
        return result

    return value


def _compile(node: ast.expr, text: str) -> Compiled:
    match node:
        case ast.Constant(value=bool() | complex()):
            pass
        case ast.Constant(value=int() | float() as number):
            constant = float(number)  # in so few letters none is too large
            return lambda k: constant
        case ast.Name(id="k"):
            return float
        case ast.Name(id=name) if name in CONSTANTS:
            named = CONSTANTS[name]
            return lambda k: named
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            inner = _compile(operand, text)
            return lambda k: -inner(k)
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _compile(operand, text)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in BINARY:
            first, combine, second = _compile(left, text), BINARY[type(op)], _compile(right, text)
            return lambda k: combine(first(k), second(k))
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in FUNCTIONS:
            function, argued = FUNCTIONS[name], _compile(argument, text)
            return lambda k: function(argued(k))
    found = ast.get_source_segment(text.strip(), node) or type(node).__name__
    raise ValueError(f"\"{text}\": {found} is not allowed; allowed: {ALLOWED}")
