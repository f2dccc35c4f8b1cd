"""Formulas of GenApi (SwissKnife, Converter), compiled to functions of their variables."""

from __future__ import annotations

import functools
import math
import operator
import re
from collections.abc import Callable, Mapping

Number = int | float
Variables = Callable[[str], Number]
Compiled = Callable[[Variables], Number]

_TOKEN = re.compile(
    r"\s*(0[xX][0-9a-fA-F]+|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[A-Za-z_][\w.]*|\*\*|<<|>>|<>|<=|>=|==|!=|&&|\|\||\S)"
)
_PRECEDENCE = (
    ("||",), ("&&",), ("|",), ("^",), ("&",), ("=", "==", "<>", "!="), ("<", ">", "<=", ">="), ("<<", ">>"),
    ("+", "-"), ("*", "/", "%"),
)  # fmt: skip
"""Left-associative binary operators, the loosest first."""
_FUNCTIONS: dict[str, Callable[[Number], Number]] = {
    "SIN": math.sin, "COS": math.cos, "TAN": math.tan, "ASIN": math.asin, "ACOS": math.acos, "ATAN": math.atan,
    "ABS": abs, "EXP": math.exp, "LN": math.log, "LG": math.log10, "SQRT": math.sqrt, "TRUNC": math.trunc,
    "FLOOR": math.floor, "CEIL": math.ceil, "ROUND": round, "NEG": operator.neg,
    "SGN": lambda value: (value > 0) - (value < 0),
}  # fmt: skip


_LARGEST_EXPONENT = 1023
_MOST_BITS = 4096  # of a power; floats end at 1024


class FormulaError(ValueError):
    """A formula that cannot be parsed, or has no value for these variables."""


def _divide(integer: bool, left: Number, right: Number) -> Number:
    if right == 0:
        raise FormulaError("division by zero")
    return math.trunc(left / right) if integer and abs(left) < 1 << 53 else left // right if integer else left / right


def _remainder(left: Number, right: Number) -> Number:
    if right == 0:
        raise FormulaError("division by zero")
    return math.fmod(left, right)


def _raise(base: Number, exponent: Number) -> Number:
    if abs(exponent) > _LARGEST_EXPONENT:
        raise FormulaError(f"the exponent {exponent} is too large")
    if isinstance(base, int) and base.bit_length() * exponent > _MOST_BITS:
        raise FormulaError("a power is too large")
    if base < 0 and exponent != int(exponent):
        raise FormulaError(f"{base} to the power of {exponent} is not a real number")
    return base**exponent if base or exponent >= 0 else 0


def _binary(symbol: str, integer: bool) -> Callable[[Number, Number], Number]:
    whole: Mapping[str, Callable[[int, int], int]] = {
        "|": operator.or_, "^": operator.xor, "&": operator.and_,
        "<<": lambda left, right: left << right & (1 << 64) - 1 if right < 64 else 0, ">>": operator.rshift,
    }  # fmt: skip
    if symbol in whole:
        function = whole[symbol]
        return lambda left, right: function(int(left), int(right))
    if symbol == "/":
        return functools.partial(_divide, integer)
    functions: Mapping[str, Callable[[Number, Number], Number]] = {
        "=": operator.eq, "==": operator.eq, "<>": operator.ne, "!=": operator.ne, "<": operator.lt, ">": operator.gt,
        "<=": operator.le, ">=": operator.ge, "+": operator.add, "-": operator.sub, "*": operator.mul,
        "||": lambda left, right: int(bool(left) or bool(right)),
        "&&": lambda left, right: int(bool(left) and bool(right)),  # both sides are evaluated, as clients do
        "%": _remainder,
    }  # fmt: skip
    return functions[symbol]


class _Parser:
    """Recursive descent over the tokens of one formula."""

    def __init__(self, text: str, integer: bool) -> None:
        self._text = text
        self._tokens = _TOKEN.findall(text)
        self._at = 0
        self._integer = integer

    def parse(self) -> Compiled:
        compiled = self._ternary()
        if self._at != len(self._tokens):
            raise FormulaError(f"formula {self._text!r}: {self._tokens[self._at]!r} is out of place")
        return compiled

    def _take(self, *symbols: str) -> str | None:
        if self._at < len(self._tokens) and self._tokens[self._at] in symbols:
            self._at += 1
            return str(self._tokens[self._at - 1])
        return None

    def _expect(self, symbol: str) -> None:
        if self._take(symbol) is None:
            raise FormulaError(f"formula {self._text!r}: {symbol!r} is missing")

    def _ternary(self) -> Compiled:
        condition = self._level(0)
        if not self._take("?"):
            return condition
        yes = self._ternary()
        self._expect(":")
        no = self._ternary()
        return lambda variables: yes(variables) if condition(variables) else no(variables)

    def _level(self, level: int) -> Compiled:
        if level == len(_PRECEDENCE):
            return self._unary()
        left = self._level(level + 1)
        while symbol := self._take(*_PRECEDENCE[level]):
            left = self._join(symbol, left, self._level(level + 1))
        return left

    def _join(self, symbol: str, left: Compiled, right: Compiled) -> Compiled:
        function = _binary(symbol, self._integer)
        return lambda variables: function(left(variables), right(variables))

    def _unary(self) -> Compiled:
        symbol = self._take("-", "+", "~", "!")
        if symbol is None:
            return self._power()
        operand = self._unary()
        if symbol == "+":
            return operand
        if symbol == "-":
            return lambda variables: -operand(variables)
        if symbol == "~":
            return lambda variables: ~int(operand(variables))
        return lambda variables: int(not operand(variables))

    def _power(self) -> Compiled:
        base = self._atom()
        if not self._take("**"):
            return base
        exponent = self._unary()
        return lambda variables: _raise(base(variables), exponent(variables))

    def _atom(self) -> Compiled:
        if self._take("("):
            inner = self._ternary()
            self._expect(")")
            return inner
        if self._at == len(self._tokens):
            raise FormulaError(f"formula {self._text!r} ends too early")
        token = str(self._tokens[self._at])
        self._at += 1
        if token[0].isdigit() or token[0] == ".":
            number: Number = float(token) if re.search(r"^[^xX]*[.eE]", token) else int(token, 0)
            return lambda variables: number
        if self._take("("):
            return self._call(token)
        constants = {"PI": math.pi, "E": math.e}
        return lambda variables: constants[token] if token in constants else variables(token)

    def _call(self, name: str) -> Compiled:
        function = _FUNCTIONS.get(name.upper())
        if function is None:
            raise FormulaError(f"formula {self._text!r}: unknown function {name}")
        argument = self._ternary()
        if self._take(","):  # ROUND(value, digits)
            self._ternary()
        self._expect(")")
        return lambda variables: function(argument(variables))


@functools.lru_cache(maxsize=8192)
def compile_formula(text: str, integer: bool) -> Compiled:
    """The formula as a function of its variables; `integer` formulas divide as integers do.

    Raises
    ------
    FormulaError
        When the text is not a formula. The function raises it too, for a division by zero among others.
    """
    return _Parser(text, integer).parse()
