"""Total derivatives of functions of the state along the flight, exact, and the order of a state constraint.

Of S(x, p) and the dynamics x' = f(x, u, p) forward differentiation through the operations of S makes

    S'(x, u, p) = sum of dS/dx_i f_i

as a tape like any other, and of that S'' and so on until a control appears: the *order* of S is how often that takes.
Terms that do not change are left out, not multiplied by zero, so that a control is in S^(q) only where it may act.
Where its effects cancel (a lift across the velocity leaves the speed as it is) the operations do not tell: that is seen
by numbers, and the control left out.

Source: Bryson, Denham, Dreyfus, *Optimal programming problems with inequality constraints*, AIAA Journal 1 (11), 1963;
differentiation of a list of operations: Griewank, Walther, *Evaluating Derivatives*, 2008, chapter 3.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.core import NUMERIC, Matrix, Vector
from perilune.problem.tracing.tape import ROLES, Expression, Recorder, Symbol, operands

MOST_ORDER = 4  # derivatives that are considered; states are coupled more directly than that
_TOUCHED = 2  # derivatives that show a contact point: S' vanishes there, and S'' does not
_LOOKS, _FEWEST = 200, 5  # points at which effects of a control are compared, and those that have to tell anything
_CANCELS = 1e-9  # of the effects: less of their sum is rounding
Inputs = Mapping[tuple[str, str], Any]  # by (role, component)

# Data of a rate: the value of the operation, its operands and their rates (None where they do not change).
_UNARY: dict[str, Callable[[Any, Any, Any, Any], Any]] = {
    "neg": lambda xp, v, a, da: -da,
    "sqrt": lambda xp, v, a, da: da / (2.0 * v),
    "sin": lambda xp, v, a, da: xp.cos(a) * da,
    "cos": lambda xp, v, a, da: -(xp.sin(a) * da),
    "tan": lambda xp, v, a, da: (1.0 + v * v) * da,
    "asin": lambda xp, v, a, da: da / xp.sqrt(1.0 - a * a),
    "acos": lambda xp, v, a, da: -(da / xp.sqrt(1.0 - a * a)),
    "atan": lambda xp, v, a, da: da / (1.0 + a * a),
    "sinh": lambda xp, v, a, da: xp.cosh(a) * da,
    "cosh": lambda xp, v, a, da: xp.sinh(a) * da,
    "tanh": lambda xp, v, a, da: (1.0 - v * v) * da,
    "exp": lambda xp, v, a, da: v * da,
    "log": lambda xp, v, a, da: da / a,
    "fabs": lambda xp, v, a, da: xp.where(a < 0.0, -da, da),
}


def _add_rates(one: Any, other: Any) -> Any:
    return other if one is None else one if other is None else one + other


def _negate_rate(one: Any) -> Any:
    return None if one is None else -one


def _scale_rate(one: Any, factor: Any) -> Any:
    return None if one is None else one * factor


def _power_rate(xp: Any, v: Any, a: Any, b: Any, da: Any, db: Any) -> Any:
    """Return d(a^b) = b a^(b-1) da + a^b log(a) db; of no term that does not change is a logarithm taken."""
    first = None
    if da is not None:
        first = 2.0 * a * da if isinstance(b, float) and b == 2.0 else b * a ** (b - 1.0) * da
    return first if db is None else _add_rates(first, v * xp.log(a) * db)


def _select_rate(xp: Any, condition: Any, da: Any, db: Any) -> Any:
    return xp.where(condition, 0.0 if da is None else da, 0.0 if db is None else db)


_BINARY: dict[str, Callable[[Any, Any, Any, Any, Any, Any], Any]] = {
    "add": lambda xp, v, a, b, da, db: _add_rates(da, db),
    "sub": lambda xp, v, a, b, da, db: _negate_rate(db) if da is None else da if db is None else da - db,
    "mul": lambda xp, v, a, b, da, db: _add_rates(_scale_rate(da, b), _scale_rate(db, a)),
    "div": lambda xp, v, a, b, da, db: (da if db is None else _add_rates(da, -(v * db))) / b,
    "pow": _power_rate,
    "atan2": lambda xp, v, a, b, da, db: (
        _add_rates(_scale_rate(da, b), _negate_rate(_scale_rate(db, a))) / (a * a + b * b)
    ),
    "fmin": lambda xp, v, a, b, da, db: _select_rate(xp, a <= b, da, db),
    "fmax": lambda xp, v, a, b, da, db: _select_rate(xp, a >= b, da, db),
}


def _rate_of(xp: Any, name: str, value: Any, of: Sequence[Any], rates: Sequence[Any], table: Any) -> Any:
    """Return the rate of one operation; a comparison has none, and a choice that of the side taken."""
    if all(rate is None for rate in rates) or name in ("lt", "le", "eq", "ne"):
        return None
    if name == "where":
        return None if rates[1] is None and rates[2] is None else _select_rate(xp, of[0], *rates[1:])
    if name == "table":
        return table.slope(of[0], xp.where) * rates[0]
    if name in _UNARY:
        return _UNARY[name](xp, value, of[0], rates[0])
    return _BINARY[name](xp, value, *of, *rates)


def run_expression(expression: Expression, recorder: Recorder, inputs: Inputs | None = None) -> list[Any]:
    """Return the values of an expression as symbols of a recorder, with `inputs` in place of those of these names.

    Parameters
    ----------
    expression
        The expression to run.
    recorder
        Recorder that notes its operations.
    inputs
        Symbols in place of components, by (role, name).
    """
    records: dict[str, Any] = {role: SimpleNamespace() for role in expression.roles}
    for role, name in (op for op in expression.tape.instructions if op[0] in ROLES):
        symbol = inputs[role, name] if inputs and (role, name) in inputs else recorder.input(role, name)
        if name:
            setattr(records[role], name, symbol)
        else:
            records[role] = symbol
    found = expression(*records.values(), recorder.namespace)
    return [found] if expression.scalar else list(found)


def gather_expressions(parts: Sequence[Expression], roles: tuple[str, ...]) -> Expression:
    """Return all values of several expressions as those of one, which takes the records `roles`.

    Parameters
    ----------
    parts
        Expressions, whose values follow each other in the result.
    roles
        Records that the result takes, in order: "x", "u", "p", "t".
    """
    recorder = Recorder()
    values = [value for part in parts for value in run_expression(part, recorder)]
    return Expression(recorder.tape(values), roles, origin=parts[0].origin if parts else "")


def component(expression: Expression, k: int) -> Expression:
    """Return one value of an expression.

    Parameters
    ----------
    expression
        Expression of several values.
    k
        Number of the value.
    """
    recorder = Recorder()
    tape = recorder.tape([run_expression(expression, recorder)[k]])
    return Expression(tape, expression.roles, origin=expression.origin)


def depends_on_control(expression: Expression) -> bool:
    """Return True if an expression has a control in it."""
    return any(op[0] == "u" for op in expression.tape.instructions)


def depends_linearly_on_control(expression: Expression, control: str) -> bool:
    """Return True if a control is in each value of an expression, with a slope that does not depend on it.

    Judged by the operations, so that a slope which only cancels does not count as linear.

    Parameters
    ----------
    expression
        Traced function of states, controls and parameters.
    control
        Name of the component of the control.
    """
    degree: list[int] = []
    for operation in expression.tape.instructions:
        name, *rest = operation
        of = [degree[i] for i in operands(operation)]
        if name in ROLES:
            degree.append(int(name == "u" and rest[0] == control))
        elif name in ("add", "sub", "neg"):
            degree.append(max(of))
        elif name == "mul":
            degree.append(min(sum(of), 2))
        elif name == "div":
            degree.append(2 if of[1] else of[0])
        elif name == "where":
            degree.append(2 if of[0] else max(of[1:]))
        else:
            degree.append(2 if any(of) else 0)
    return max((degree[k] for k in expression.tape.outputs), default=0) == 1


def total_derivative(function: Expression, dynamics: Expression, states: Sequence[str]) -> Expression:
    """Derive the total derivatives of a function's values along the flight.

    Parameters
    ----------
    function
        Of states and parameters, ``f(x, p)`` or ``f(x, u, p)`` without a control in it.
    dynamics
        ``f(x, u, p)``.
    states
        Names of the states, in the order of the rates.
    """
    recorder = Recorder()
    xp = recorder.namespace
    rates = dict(zip(states, run_expression(dynamics, recorder), strict=True))
    tables = {table.digest: table for table in function.tape.tables}
    values, found = list[Any](), list[Any]()
    for operation in function.tape.instructions:
        name, *rest = operation
        at = operands(operation)
        if name in ROLES:
            values.append(recorder.input(name, rest[0]))
            found.append(_nonzero_rate(rates[rest[0]]) if name == "x" else None)
        elif name == "const":
            values.append(float(rest[0]))
            found.append(None)
        else:
            of = [values[i] for i in at]
            table = tables[rest[1]] if name == "table" else None
            value = xp.table(table, of[0]) if table is not None else recorder.do(name, *of)
            values.append(value)
            found.append(_rate_of(xp, name, value, of, [found[i] for i in at], table))
    outputs = [0.0 if found[k] is None else found[k] for k in function.tape.outputs]
    return Expression(recorder.tape(outputs), ("x", "u", "p"), origin=function.origin)


def _nonzero_rate(value: Any) -> Any:
    """Return a rate that may be other than zero, else None."""
    return value if isinstance(value, Symbol) or value != 0 else None


def derivatives_to_control(function: Expression, dynamics: Expression, states: Sequence[str]) -> tuple[Expression, ...]:
    """Return (S, S', ..., S^(q)), the last being the first with a control in it: q is the order of S.

    Parameters
    ----------
    function, dynamics, states
        As of `total_derivative`; a function with a control in it is of order 0.

    Returns
    -------
    tuple of Expression
        Where no control appears, (S, S', S'') without one: by these a flight that touches S = 0 is detected.
    """
    found = [function]
    steered = depends_on_control(function) or depends_on_control(dynamics)
    while not depends_on_control(found[-1]):
        if len(found) > (MOST_ORDER if steered else _TOUCHED):
            return tuple(found[: _TOUCHED + 1])
        found.append(_next_derivative(found[-1], dynamics, tuple(states)))
    return tuple(found)


@lru_cache(maxsize=64)
def _next_derivative(function: Expression, dynamics: Expression, states: tuple[str, ...]) -> Expression:
    """Return the rate of one value, without a control whose effects on it cancel."""
    found = total_derivative(function, dynamics, states)
    if not depends_on_control(found) or not _control_effect_cancels(function, dynamics, states):
        return found
    recorder = Recorder()
    fixed = {operation: 1.0 for operation in found.tape.instructions if operation[0] == "u"}
    return Expression(recorder.tape(run_expression(found, recorder, fixed)), found.roles, origin=found.origin)


def _control_effect_cancels(function: Expression, dynamics: Expression, states: tuple[str, ...]) -> bool:
    """Return True if dS/dx (f(x, u) - f(x, v)) vanishes, term against term, wherever it can be computed."""
    rng = np.random.default_rng(0)
    names = {op for tape in (function.tape, dynamics.tape) for op in tape.instructions if op[0] in ROLES}
    names |= {("x", name) for name in states}

    def drawn(role: str) -> Any:
        return SimpleNamespace(**{name: rng.uniform(0.1, 2.0, _LOOKS) for r, name in sorted(names) if r == role})

    x, p, one, other = drawn("x"), drawn("p"), drawn("u"), drawn("u")
    with np.errstate(all="ignore"):
        slopes = [_slope(function, name, states, x, p) for name in states]
        change = _expression_values(dynamics, x, one, p) - _expression_values(dynamics, x, other, p)
        effects = np.array(slopes) * change
        size, total = np.abs(effects).sum(axis=0), np.abs(effects.sum(axis=0))
    known = np.isfinite(size) & (size > 0)
    return int(known.sum()) >= _FEWEST and bool((total[known] <= _CANCELS * size[known]).all())


def _slope(function: Expression, name: str, states: tuple[str, ...], x: Any, p: Any) -> Vector:
    """Return dS/dx_i at points: the rate of S where only that state changes."""
    one = Recorder()
    alone = Expression(one.tape([float(name == state) for state in states]), ("x", "u", "p"))
    return _expression_values(total_derivative(function, alone, states), x, SimpleNamespace(), p)[0]


def _expression_values(expression: Expression, x: Any, u: Any, p: Any) -> Matrix:
    """Evaluate an expression at points, (values, points)."""
    records = {"x": x, "u": u, "p": p}
    found = expression(*(records[role] for role in expression.roles), NUMERIC)
    return np.array([np.broadcast_to(np.asarray(value, dtype=float), _LOOKS) for value in found])
