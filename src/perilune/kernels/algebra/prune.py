"""Removal of decoupled equations before anything is compiled.

The sparsity of dz'/dz is a dependency graph. What neither the wanted outputs nor the rates of what
they need depend on (downrange angle, a costate that only accumulates) is dropped; what never changes (the
costate of a cyclic coordinate) becomes a parameter, or a number where its value is known. The rest is the
same computation.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from perilune.core import PeriluneError


@dataclass(frozen=True, kw_only=True)
class Pruned:
    """A right-hand side without what decouples.

    Attributes
    ----------
    rhs
        (z kept, p with the constants of motion appended) -> z' kept.
    kept, constant, dropped
        Which entries of the whole z are integrated, are carried as parameters, are left out.
    """

    rhs: Any
    kept: tuple[int, ...]
    constant: tuple[int, ...]
    dropped: tuple[int, ...]


def prune(rhs: Any, outputs: Iterable[int] | Sequence[Any], *, fixed: Mapping[int, float] | None = None) -> Pruned:
    """Drop from z what the outputs do not need.

    Parameters
    ----------
    rhs
        SX ``casadi.Function`` (z, p) -> z'.
    outputs
        Entries of z that are wanted at the end, or SX functions (z, p) -> something wanted (boundary
        conditions, events).
    fixed
        Constants of motion with a known value, by entry (the costate of a free cyclic coordinate is 0).

    Raises
    ------
    PeriluneError
        If a fixed entry is not a constant of motion.
    """
    import casadi as ca

    known = dict(fixed or {})
    z, p = ca.SX.sym("z", rhs.size1_in(0)), ca.SX.sym("p", rhs.size1_in(1))
    whole = z
    for entry, value in known.items():
        whole = ca.substitute(whole, z[entry], value)
    rate = ca.densify(rhs(whole, p))
    steady = {i for i in range(rate.numel()) if rate[i].is_constant() and float(rate[i]) == 0.0}
    if not known.keys() <= steady:
        raise PeriluneError(
            "a fixed entry of z is not a constant of motion",
            got=str(sorted(known.keys() - steady)),
            expected=f"among {sorted(steady)}",
            advice="fix only what has rate zero",
        )
    needs = _dependence(rate, z)
    wanted = _output_entries(outputs, z, p)
    while True:
        grown = wanted.union(*(needs[i] for i in wanted))
        if grown == wanted:
            break
        wanted = grown
    kept = tuple(sorted(wanted - steady))
    constant = tuple(sorted((wanted & steady) - known.keys()))
    dropped = tuple(i for i in range(z.numel()) if i not in kept and i not in constant and i not in steady)
    parameters = ca.vertcat(p, *(z[i] for i in constant))
    reduced = ca.Function(
        "pruned", [ca.vertcat(*(z[i] for i in kept)), parameters], [ca.vertcat(*(rate[i] for i in kept))]
    )
    return Pruned(rhs=reduced, kept=kept, constant=constant, dropped=dropped)


def _dependence(rate: Any, z: Any) -> list[set[int]]:
    """Return the entries of z that each rate depends on."""
    import casadi as ca

    rows, columns = ca.jacobian(rate, z).sparsity().get_triplet()
    found: list[set[int]] = [set() for _ in range(z.numel())]
    for row, column in zip(rows, columns, strict=True):
        found[row].add(column)
    return found


def _output_entries(outputs: Iterable[Any], z: Any, p: Any) -> set[int]:
    import casadi as ca

    wanted: set[int] = set()
    for output in outputs:
        if isinstance(output, (int, np.integer)):
            wanted.add(int(output))
        else:
            wanted |= set(ca.jacobian(ca.vec(output(z, p)), z).sparsity().get_triplet()[1])
    return wanted
