"""Records of arc propagation: requests, results, and the ways an arc can end.

An arc is the flight of z' = f(z, p) over a duration, over the events on its way.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from perilune.core import Matrix, PeriluneError, Stack, Vector

#: Events recorded for each lane; an arc with more ends with `ArcStatus.STEP_LIMIT`.
MAX_EVENTS = 64
#: Step attempts allowed to an arc when nothing else is asked.
MAX_STEPS = 5000

#: What the stepping loop is handed: one table of pointers and whole numbers, in this order.
TABLE = (
    "equations",
    "lanes",
    "order",
    "z0",
    "p",
    "p_stride",
    "duration",
    "seeds",
    "rtol",
    "atol",
    "mode",
    "max_steps",
    "fixed_steps",
    "z",
    "rates",
    "columns",
    "info",
    "log",
    "nodes",
)
#: What equations state of themselves in a table of their own, behind which are their transitions: how many numbers
#: there are, where the entries of S kept in Y lie within an array (nz, nc), and where their functions are.
EQUATIONS = ("nz", "n", "np", "nc", "constants", "offsets", "fill", "field", "crossings")
#: What is reported of each lane, as doubles.
INFO = ("time", "status", "steps", "mode", "events")


class ArcStatus(IntEnum):
    """The ways in which an arc ends."""

    REACHED = 0  # flown for its whole duration
    EVENT = 1  # at a terminal event
    STEP_LIMIT = 2  # out of steps (or of room for events)
    NON_FINITE = 3  # a NaN or an infinity that no smaller step avoids
    STALLED = 4  # the step fell below what the duration resolves


@dataclass(frozen=True, kw_only=True)
class Arcs:
    """Ends of a batch of arcs.

    Attributes
    ----------
    z
        Shape (lanes, nz).
    rates
        z' there, in the mode at the end, (lanes, nz): the end moves by it for each unit of duration.
    columns
        S at the end, (lanes, nz, nc); with nc = 0 where none were asked. At a terminal event S is taken at
        the fixed time of the event; the shift of that time is -(dg/dz S)/(dg/dz f).
    time
        Time flown, (lanes,); the duration unless an event or a failure ended the arc.
    status
        `ArcStatus` of each lane, (lanes,), int64.
    steps
        Steps taken, (lanes,), int64.
    mode
        Mode at the end, (lanes,), int64.
    event_index, event_time
        Events in order, (lanes, MAX_EVENTS): their index (-1: none) and their time (NaN: none).
    """

    z: Matrix
    rates: Matrix
    columns: Stack
    time: Vector
    status: NDArray[np.int64]
    steps: NDArray[np.int64]
    mode: NDArray[np.int64]
    event_index: NDArray[np.int64]
    event_time: Matrix

    @property
    def succeeded(self) -> NDArray[np.bool_]:
        """Lanes that reached their end or a terminal event."""
        return (self.status == ArcStatus.REACHED) | (self.status == ArcStatus.EVENT)


@dataclass(frozen=True, kw_only=True)
class Request:
    """A batch as the integrators take it: contiguous arrays of doubles."""

    z0: Matrix  # (lanes, nz)
    p: Matrix  # (lanes, np) or (1, np) for all lanes
    duration: Vector  # (lanes,)
    seeds: Stack | None  # (lanes, nz, nc)
    rtol: Vector  # (lanes,)
    atol: Vector  # (lanes,)
    mode: Vector  # (lanes,), whole
    max_steps: int = MAX_STEPS
    fixed_steps: int = 0


def request(
    sizes: tuple[int, int, int],
    modes: int,
    z0: ArrayLike,
    p: ArrayLike,
    duration: ArrayLike,
    columns: ArrayLike | None,
    *,
    rtol: ArrayLike = 1e-12,
    atol: ArrayLike = 1e-12,
    fixed_steps: int | None = None,
    max_steps: int = MAX_STEPS,
    mode: ArrayLike = 0,
) -> Request:
    """Check a call of `propagate` and bring it to one form.

    Parameters
    ----------
    sizes
        (nz, np, nc): numbers of states, parameters and columns of the system.
    modes
        Number of modes of the dynamics.
    z0
        States at the start, shape (lanes, nz) or (nz,).
    p
        Parameters, shape (lanes, np), or (np,) for all.
    duration
        Durations, shape (lanes,) or one for all, in the unit of time of the system; negative backward in time.
    columns
        Derivatives S(0) of z0 by nc numbers, shape (lanes, nz, nc) or (nz, nc); None for the states only.
    rtol, atol
        Relative and absolute tolerance of the error of a step in z, shape (lanes,) or one for all.
    fixed_steps
        Number of equal steps instead of steps by error; None for control by error.
    max_steps
        Attempted steps after which an arc ends with `ArcStatus.STEP_LIMIT`.
    mode
        Mode of the dynamics at the start, shape (lanes,) or one for all.

    Raises
    ------
    PeriluneError
        On shapes that do not fit (nz, np, nc) = `sizes`, or a mode that does not exist.
    """
    nz, parameters, nc = sizes
    start = np.ascontiguousarray(np.atleast_2d(np.asarray(z0, dtype=float)))
    lanes = len(start)
    if start.shape != (lanes, nz):
        raise PeriluneError("z0 has the wrong shape", got=str(np.shape(z0)), expected=f"(lanes, {nz})")
    values = np.ascontiguousarray(np.atleast_2d(np.asarray(p, dtype=float)))
    if values.shape not in ((1, parameters), (lanes, parameters)):
        raise PeriluneError(
            "p has the wrong shape",
            got=str(np.shape(p)),
            expected=f"({parameters},) or ({lanes}, {parameters})",
        )
    seeds = None
    if columns is not None and nc:
        seeds = np.ascontiguousarray(np.asarray(columns, dtype=float).reshape((-1, *np.shape(columns)[-2:])))
        if seeds.shape == (1, nz, nc) and lanes > 1:
            seeds = np.ascontiguousarray(np.broadcast_to(seeds, (lanes, nz, nc)))
        if seeds.shape != (lanes, nz, nc):
            raise PeriluneError(
                "the seeds of the columns have the wrong shape",
                got=str(np.shape(columns)),
                expected=f"({lanes}, {nz}, {nc})",
            )
    starting = _per_lane(mode, lanes, "mode")
    if lanes and not 0 <= starting.min() <= starting.max() < modes:
        raise PeriluneError("an arc starts in a mode that does not exist", got=str(mode), expected=f"0 to {modes - 1}")
    return Request(
        z0=start,
        p=values,
        duration=_per_lane(duration, lanes, "duration"),
        seeds=seeds,
        rtol=_per_lane(rtol, lanes, "rtol"),
        atol=_per_lane(atol, lanes, "atol"),
        mode=starting,
        max_steps=int(max_steps),
        fixed_steps=int(fixed_steps or 0),
    )


def _per_lane(value: ArrayLike, lanes: int, name: str) -> Vector:
    array = np.asarray(value, dtype=float)
    if array.shape not in ((), (1,), (lanes,)):
        raise PeriluneError(f"{name} has the wrong shape", got=str(array.shape), expected=f"() or ({lanes},)")
    if array.shape == (lanes,):
        return np.ascontiguousarray(array)
    result = np.empty(lanes)
    result[:] = array
    return result
