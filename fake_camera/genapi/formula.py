"""Formulas of GenApi (SwissKnife, Converter), compiled to functions of their variables.

They mean what they mean to EMVA's reference implementation, which differs from C and from Aravis in places:
docs/understand/decisions/0017-reference-genapi.md lists them.
"""

from __future__ import annotations

import functools
import math
import operator
import re
from collections.abc import Callable, Mapping

Number = int | float
Variables = Callable[[str], Number]
Compiled = Callable[[Variables], Number]

_TOKEN = re.compile(r"\s*(0[xX][0-9a-fA-F]+|\d+\.?\d*(?:[eE][+-]?\d+)?|[A-Za-z_][\w.]*|\*\*|<<|>>|<>|<=|>=|&&|\|\||\S)")
_PRECEDENCE = (
    ("||", "&&", "=", "<>", "<", ">", "<=", ">="), ("+", "-"), ("*", "/", "%"), ("**",), ("<<", ">>", "&", "^", "|"),
)  # fmt: skip
"""Binary operators, the loosest first; those of one level are taken from left to right."""
_POWER = 3


def rounded(value: Number) -> int:
    """The nearest whole number; halves are rounded away from 0."""
    return value if isinstance(value, int) else int(math.copysign(math.floor(abs(value) + 0.5), value))


def _round(value: Number, digits: Number = 0) -> Number:
    scale = 10.0**digits
    return math.copysign(math.floor(abs(value) * scale + 0.5) / scale, value)


def _logarithm(function: Callable[[float], float], value: Number) -> float:
    return function(value) if value else -math.inf


_FUNCTIONS: dict[str, Callable[..., Number]] = {
    "SIN": math.sin, "COS": math.cos, "TAN": math.tan, "ASIN": math.asin, "ACOS": math.acos, "ATAN": math.atan,
    "ABS": abs, "EXP": math.exp, "LN": functools.partial(_logarithm, math.log),
    "LG": functools.partial(_logarithm, math.log10), "SQRT": math.sqrt, "TRUNC": math.trunc, "FLOOR": math.floor,
    "CEIL": math.ceil, "ROUND": _round, "NEG": operator.neg, "FRAC": lambda value: math.fmod(value, 1.0),
    "SGN": lambda value: (value > 0) - (value < 0),
}  # fmt: skip
_ON_WHOLE_ARGUMENTS = ("NEG", "SGN")
"""The functions that integer formulas have."""
_BEYOND = 1 << 63  # the largest whole number, and 1
_CONSTANTS = {"PI": math.pi, "E": math.e}


class FormulaError(ValueError):
    """A formula that cannot be parsed, or has no value for these variables."""


def signed(value: int) -> int:
    """The lowest 64 bits of a whole number, as one with a sign."""
    return (value + _BEYOND & (1 << 64) - 1) - _BEYOND


def _divide(left: Number, right: Number) -> Number:
    if right == 0:
        raise FormulaError("division by zero")
    return left / right


def _divide_whole(left: Number, right: Number) -> int:
    if right == 0:
        raise FormulaError("division by zero")
    quotient = abs(int(left)) // abs(int(right))
    return quotient if (left < 0) == (right < 0) else -quotient


def _remainder(left: Number, right: Number) -> Number:
    if right == 0:
        raise FormulaError("division by zero")
    return math.fmod(left, right)


def _remainder_whole(left: Number, right: Number) -> int:
    return int(left) - int(right) * _divide_whole(left, right)


def _raise(base: Number, exponent: Number) -> float:
    try:
        return math.pow(base, exponent)
    except ValueError:
        return math.nan if base else math.inf
    except OverflowError:
        return math.inf


def _raise_whole(base: Number, exponent: Number) -> int:
    if not 0 <= exponent < 64:
        power = _raise(base, exponent)
        return int(power) if abs(power) < _BEYOND else -_BEYOND
    power = int(base) ** int(exponent)
    return power if abs(power) < _BEYOND else -_BEYOND


_ON_ANY: Mapping[str, Callable[[Number, Number], Number]] = {
    "=": operator.eq, "<>": operator.ne, "<": operator.lt, ">": operator.gt, "<=": operator.le, ">=": operator.ge,
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": _divide, "%": _remainder, "**": _raise,
    "||": lambda left, right: int(bool(left) or bool(right)),  # both sides are evaluated, and so they are below
    "&&": lambda left, right: int(bool(left) and bool(right)),
}  # fmt: skip
_ON_WHOLE: Mapping[str, Callable[[int, int], int]] = {
    "|": operator.or_, "^": operator.xor, "&": operator.and_,
    "<<": lambda left, right: signed(left << (right & 63)), ">>": lambda left, right: left >> (right & 63),
}  # fmt: skip


def _binary(symbol: str, integer: bool) -> Callable[[Number, Number], Number]:
    if symbol in _ON_WHOLE:
        on_whole = _ON_WHOLE[symbol]
        return lambda left, right: on_whole(int(left), int(right))
    if not integer:
        return _ON_ANY[symbol]
    function = {"/": _divide_whole, "%": _remainder_whole, "**": _raise_whole}.get(symbol, _ON_ANY[symbol])
    return lambda left, right: signed(int(function(left, right)))


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
        chosen = self._level(0)
        while self._take("?"):
            yes = self._level(0)
            self._expect(":")
            chosen = self._choose(chosen, yes, self._level(0))
        return chosen

    def _choose(self, condition: Compiled, yes: Compiled, no: Compiled) -> Compiled:
        def choose(variables: Variables) -> Number:
            both = yes(variables), no(variables)  # an error in either is one of the whole
            return both[0] if condition(variables) else both[1]

        return choose

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
        symbol = self._take("-", "+", "~")
        if symbol is None:
            return self._atom()
        # The sign of a number or a variable belongs to it; a bracket's is that of the power of the bracket.
        bracket = symbol == "-" and "(" in self._tokens[self._at : self._at + 2]
        operand = self._level(_POWER) if bracket else self._unary()
        if symbol == "+":
            return operand
        if symbol == "-":
            return lambda variables: -operand(variables)
        return lambda variables: ~int(operand(variables))

    def _atom(self) -> Compiled:
        if self._take("("):
            inner = self._ternary()
            self._expect(")")
            return inner
        if self._at == len(self._tokens):
            raise FormulaError(f"formula {self._text!r} ends too early")
        token = str(self._tokens[self._at])
        self._at += 1
        if token[0].isdigit():
            return self._constant(float(token) if re.search(r"^[^xX]*[.eE]", token) else int(token, 0))
        if self._take("("):
            return self._call(token)
        return self._constant(_CONSTANTS[token]) if token in _CONSTANTS else lambda variables: variables(token)

    def _constant(self, number: Number) -> Compiled:
        value = signed(int(number)) if self._integer and number < math.inf else number
        return lambda variables: value

    def _call(self, name: str) -> Compiled:
        function = _FUNCTIONS.get(name.upper())
        if function is None or (self._integer and name.upper() not in _ON_WHOLE_ARGUMENTS):
            raise FormulaError(f"formula {self._text!r}: unknown function {name}")
        arguments = [self._ternary()]
        if self._take(","):
            arguments.append(self._ternary())
        self._expect(")")
        if len(arguments) > 1 and function is not _round:
            raise FormulaError(f"formula {self._text!r}: {name} has one argument")

        def call(variables: Variables) -> Number:
            try:
                return function(*(argument(variables) for argument in arguments))
            except FormulaError:
                raise
            except OverflowError:
                return math.inf
            except ValueError:  # outside of the function's domain
                return math.nan

        return call


@functools.lru_cache(maxsize=8192)
def compile_formula(text: str, integer: bool) -> Compiled:
    """The formula as a function of its variables; `integer` formulas compute with whole numbers of 64 bits.

    Raises FormulaError when the text is not a formula. The function raises it too, for a division by zero among others.
    """
    return _Parser(text, integer).parse()
