"""Adaptive DOP853 for groups of lanes, as LLVM IR: the whole stepping loop is machine code.

The lanes of a group step together, each with its own step, error, acceptance and end; a lane that has ended
takes steps of length zero until its group is done. The error of z alone sets the step (the scaled norm of
Hairer's code); the columns S are carried along, and because their stages solve the exact derivative of the discrete
steps they are the derivative of what was computed, to the order of the method. Values that are not finite
make the error NaN: the step is refused and shortened, and where no shorter step helps the lane ends as
NON_FINITE.

Source: Hairer, Norsett, Wanner, *Solving ODEs I*, section II.4 (initial step, step control) and II.10
(DOP853); Hairer & Wanner, *Solving ODEs II*, section IV.8 (Gustafsson's predictive controller, of which only the
caution is taken: it refuses fewer steps where the error grows from step to step).
"""

from __future__ import annotations

from collections.abc import Callable

from perilune.kernels.algebra.system import ArcSystem
from perilune.kernels.code.ir import BIT, INT, Int, Mask, Ptr, Vec, Writer
from perilune.kernels.flight import lanes, tableau
from perilune.kernels.flight.codegen_context import CallTable, Frame
from perilune.kernels.flight.event_location import EventCrossings, crossing_searches
from perilune.kernels.flight.records import ArcStatus

_SAFETY, _SHRINK, _GROW = 0.9, 0.2, 10.0
# Hairer's first step is for any order: with order 8 its error was found 1e-6 to 1e-5 of what is allowed.
_FIRST = 3.0
_LEAST = 0.01**0.125  # an error below 0.01 says little of the trend
_RESOLVED = 1e-14  # a step below this fraction of the duration is not taken


def stepping_module(system: ArcSystem, width: int) -> str:
    """Return the IR of ``void arcs(i64 first group, i64 last group, ptr table)`` and, for one lane, of ``rates``.

    It is the same for all systems of one `course`.

    Parameters
    ----------
    system
        Equations and events of the arcs.
    width
        Number of lanes that step together.
    """
    parts = [crossing_searches(width)] if system.events else []
    return "\n".join([*parts, _Stepping(system, width).arcs(), *([_write_rates(system)] if width == 1 else [])])


def _write_rates(system: ArcSystem) -> str:
    """Write ``rates(count, Y, p, modes, result, equations)``: Y' at many points with one p, for the dense output."""
    f = Frame(system, Writer(1), Ptr("%equations", INT))
    w, y, p, modes, out = f.w, *(Ptr(f"%{name}", f.w.vector) for name in ("y", "p", "modes", "out"))
    with w.loop(0, f.np) as c:
        w.store(w.load(p, c), f.parameters, c)
    f.fill_constants()
    with w.loop(0, Int("%count")) as k:
        w.store(w.load(modes, k), f.mode)
        row = w.integer("mul", k, f.n)
        f.field(w.at(y, row), w.at(out, row))
    head = "define void @rates(i64 %count, ptr %y, ptr %p, ptr %modes, ptr %out, ptr %equations) nounwind"
    return f"{head} {{\n{w.body()}\n  ret void\n}}\n"


class _Stepping:
    """Writes the stepping loop."""

    def __init__(self, system: ArcSystem, width: int) -> None:
        w = self.w = Writer(width)
        self.table = CallTable(w)
        f = self.f = Frame(system, w, self.table.equations)
        self.nz, self.n, self.entries = f.nz, f.n, w.broadcast(f.nz)
        self.crossing = EventCrossings(f) if system.events else None
        self.fixed = w.let(BIT, f"icmp sgt i64 {self.table.fixed_steps}, 0")

    def arcs(self) -> str:
        """Return the IR of ``arcs``."""
        w, f = self.w, self.f
        with w.loop(Int("%first"), Int("%last")) as group:
            lanes.gather(f, self.table, group)
            f.fill_constants()
            f.field(f.state, f.slopes[0])
            self._first_step()
            if self.crossing:
                self.crossing.begin()
            with w.repeat_while_any(f.active):
                self._step()
        return f"define void @arcs(i64 %first, i64 %last, ptr %table) nounwind {{\n{w.body()}\n  ret void\n}}\n"

    # -- the initial step
    # ----------------------------------------------------------------------------------------
    def _norm(self, value: Callable[[Int], Vec]) -> Vec:
        """Return the root mean square of value(c) over z, scaled by the tolerance at the start."""
        w, f = self.w, self.f
        total = w.buffer(1)
        w.store(w.const(0.0), total)
        with w.loop(0, self.nz) as c:
            size = w.intrinsic("fabs", w.load(f.state, c))
            scale = w.fma(w.load(f.rtol), size, w.load(f.atol))
            x = w.div(value(c), scale)
            w.store(w.fma(x, x, w.load(total)), total)
        return w.intrinsic("sqrt", w.mul(w.load(total), w.div(w.const(1.0), self.entries)))

    def _first_step(self) -> None:
        """Compute Hairer's initial step from the sizes of z, z' and an estimate of z''."""
        w, f = self.w, self.f
        duration = w.load(f.duration)
        length = w.intrinsic("fabs", duration)
        d0 = self._norm(lambda c: w.load(f.state, c))
        d1 = self._norm(lambda c: w.load(f.slopes[0], c))
        small = w.either(w.compare("olt", d0, w.const(1e-5)), w.compare("olt", d1, w.const(1e-5)))
        h0 = w.select(small, w.const(1e-6), w.mul(w.const(0.01), w.div(d0, d1)))
        h0 = w.smaller(h0, length)
        signed = w.intrinsic("copysign", h0, duration)
        with w.loop(0, self.n) as c:
            w.store(w.fma(signed, w.load(f.slopes[0], c), w.load(f.state, c)), f.new, c)
        f.field(f.new, f.slopes[-1])
        d2 = w.div(self._norm(lambda c: w.sub(w.load(f.slopes[-1], c), w.load(f.slopes[0], c))), h0)
        d = w.larger(d2, d1)
        root = w.div(w.const(0.01), d)
        for _ in range(3):
            root = w.intrinsic("sqrt", root)
        tiny = w.larger(w.const(1e-6), w.mul(h0, w.const(1e-3)))
        h1 = w.select(w.compare("ole", d, w.const(1e-15)), tiny, w.mul(w.const(_FIRST), root))
        h = w.smaller(w.smaller(h1, w.mul(h0, w.const(100.0))), length)
        each = w.div(length, w.broadcast(self.table.fixed_steps))
        h = w.choose(self.fixed, w.vector, each, h)
        w.store(h, f.h)
        w.store(w.const(float("inf")), f.limit)
        w.store(w.const(0.0), f.h_before)  # there is no trend yet
        w.store(w.const(1.0), f.root_before)

    # -- one step
    # --------------------------------------------------------------------------------------------------
    def _step(self) -> None:
        w, f = self.w, self.f
        active = w.load(f.active)
        duration, time = w.load(f.duration), w.load(f.time)
        remaining = w.sub(duration, time)
        limited = w.compare("olt", w.load(f.limit), w.load(f.h))  # cut short to meet an event
        wanted = w.smaller(w.load(f.h), w.load(f.limit))
        last = w.compare("oge", w.mul(wanted, w.const(1 + 1e-10)), w.intrinsic("fabs", remaining))
        h = w.select(last, remaining, w.intrinsic("copysign", wanted, duration))
        h = w.select(active, h, w.const(0.0))
        self._stages(h)
        error = self._error(h)
        finite = w.compare("ord", error, error)
        good = w.choose(self.fixed, w.mask, finite, w.compare("ole", error, w.const(1.0)))
        accepted = w.both(active, good)
        w.store(w.add(w.load(f.tries), w.const(1.0)), f.tries)
        held = w.allocate(w.mask, 1)
        w.store(accepted, held)
        with w.when(w.any(accepted)):
            self._finish_step(h)
            if self.crossing:
                self.crossing.locate(h, held)
        accepted = w.load(held)
        self._adapt(h, error, active, good, limited)
        self._commit(h, accepted, last)
        self._end(error, accepted, active, last)

    def _stages(self, h: Vec) -> None:
        w, f = self.w, self.f
        for stage in range(1, tableau.STAGES):
            with w.loop(0, self.n) as c:
                w.store(w.fma(h, self._combine(tableau.A[stage], c), w.load(f.state, c)), f.new, c)
            f.field(f.new, f.slopes[stage])

    def _combine(self, weights: dict[int, float], c: Int) -> Vec:
        """Sum the slopes of an entry with the weights of a row of the tableau."""
        w, f, total = self.w, self.f, None
        for stage, weight in weights.items():
            slope = w.load(f.slopes[stage], c)
            factor = w.const(weight)
            total = w.mul(slope, factor) if total is None else w.fma(slope, factor, total)
        assert total is not None, "a row of the tableau has weights"
        return total

    def _error(self, h: Vec) -> Vec:
        """Advance z into `new`; returns the scaled error, NaN if anything in it is not finite."""
        w, f = self.w, self.f
        fifth, third = w.buffer(1), w.buffer(1)
        w.store(w.const(0.0), fifth)
        w.store(w.const(0.0), third)
        with w.loop(0, self.nz) as c:
            old = w.load(f.state, c)
            new = w.fma(h, self._combine(tableau.B, c), old)
            w.store(new, f.new, c)
            size = w.larger(w.intrinsic("fabs", old), w.intrinsic("fabs", new))
            scale = w.fma(w.load(f.rtol), size, w.load(f.atol))
            inverse = w.div(w.const(1.0), scale)
            for weights, total in ((tableau.E5, fifth), (tableau.E3, third)):
                x = w.mul(self._combine(weights, c), inverse)
                w.store(w.fma(x, x, w.load(total)), total)
        e5, e3 = w.load(fifth), w.load(third)
        both = w.mul(w.fma(w.const(0.01), e3, e5), self.entries)
        bottom = w.larger(w.intrinsic("sqrt", both), w.const(1e-300))
        return w.div(w.mul(w.intrinsic("fabs", h), e5), bottom)

    def _finish_step(self, h: Vec) -> None:
        """Advance the columns, and the slopes at the end, which are the first of the next step."""
        w, f = self.w, self.f
        with w.loop(self.nz, self.n) as c:
            w.store(w.fma(h, self._combine(tableau.B, c), w.load(f.state, c)), f.new, c)
        f.field(f.new, f.slopes[-1])

    def _adapt(self, h: Vec, error: Vec, active: Mask, good: Mask, limited: Mask) -> None:
        """Set the next step: err^(-1/8), held back after a refusal or by a trend, untouched by a step cut short."""
        w, f = self.w, self.f
        root, size = error, w.intrinsic("fabs", h)
        for _ in range(3):
            root = w.intrinsic("sqrt", root)
        inverse = w.div(w.const(1.0), root)
        before = w.mul(w.load(f.root_before), w.div(size, w.load(f.h_before)))
        trend = w.smaller(w.mul(before, inverse), w.const(1.0))
        factor = w.mul(w.mul(w.const(_SAFETY), inverse), w.select(good, trend, w.const(1.0)))
        usual = w.but_not(good, limited)
        w.store(w.select(usual, size, w.load(f.h_before)), f.h_before)
        w.store(w.select(usual, w.larger(root, w.const(_LEAST)), w.load(f.root_before)), f.root_before)
        factor = w.smaller(w.larger(factor, w.const(_SHRINK)), w.const(_GROW))
        refused = w.compare("ogt", w.load(f.refused), w.const(0.0))
        factor = w.select(w.either(refused, w.opposite(good)), w.smaller(factor, w.const(1.0)), factor)
        old = w.load(f.h)
        new = w.mul(size, factor)
        new = w.select(w.both(limited, good), old, new)
        new = w.choose(self.fixed, w.vector, old, new)
        w.store(w.select(active, new, old), f.h)
        w.store(w.select(good, w.const(0.0), w.const(1.0)), f.refused)

    def _commit(self, h: Vec, accepted: Mask, last: Mask) -> None:
        w, f = self.w, self.f
        time = w.load(f.time)
        if f.width == 1:
            self._record(h, accepted, time)
        end = w.select(last, w.load(f.duration), w.add(time, h))
        w.store(w.select(accepted, end, time), f.time)
        w.store(w.add(w.load(f.steps), w.select(accepted, w.const(1.0), w.const(0.0))), f.steps)
        with w.when(w.any(accepted)):
            f.blend(accepted, f.new, f.state, self.n)
            f.blend(accepted, f.slopes[-1], f.slopes[0], self.n)

    def _record(self, h: Vec, accepted: Mask, time: Vec) -> None:
        """Note the start of an accepted step (time, length, mode, z), where nodes are asked for."""
        w, f, nodes = self.w, self.f, self.table.nodes
        wanted = w.let(BIT, f"icmp ne ptr {nodes}, null")
        with w.when(w.and_bit(wanted, w.any(accepted))):
            row = w.let(INT, f"fptosi double {w.lane(w.load(f.steps), 0)} to i64")
            begin = w.integer("mul", row, w.integer("add", self.nz, 3))
            base = Ptr(w.at(nodes, begin), w.vector)  # one lane: a double is a vector
            for place, value in enumerate((time, h, w.load(f.mode))):
                w.store(value, base, place)
            with w.loop(0, self.nz) as c:
                w.store(w.load(f.state, c), w.at(base, 3), c)

    # -- the ends
    # --------------------------------------------------------------------------------------------------
    def _end(self, error: Vec, accepted: Mask, active: Mask, last: Mask) -> None:
        w, f = self.w, self.f
        w.store(w.const(-1.0), f.status)
        h, length = w.load(f.h), w.intrinsic("fabs", w.load(f.duration))
        nan = w.compare("uno", error, error)
        finest = w.mul(length, w.const(_RESOLVED))
        stuck = w.both(active, w.compare("ult", h, finest))
        lost = w.both(w.both(active, nan), w.choose(self.fixed, w.mask, nan, stuck))
        spent = w.both(active, w.compare("oge", w.load(f.tries), w.broadcast(self.table.max_steps)))
        f.mark(spent, ArcStatus.STEP_LIMIT)
        f.mark(stuck, ArcStatus.STALLED)
        f.mark(lost, ArcStatus.NON_FINITE)
        f.mark(w.both(accepted, last), ArcStatus.REACHED)
        if self.crossing:
            self.crossing.fire(self.table)
        ended = w.both(active, w.compare("oge", w.load(f.status), w.const(0.0)))
        with w.when(w.any(ended)):
            total = w.buffer(1)
            w.store(w.const(0.0), total)
            with w.loop(0, self.n) as c:  # 0 x is NaN for what is not finite
                w.store(w.fma(w.load(f.state, c), w.const(0.0), w.load(total)), total)
            f.mark(w.both(ended, w.compare("uno", w.load(total), w.load(total))), ArcStatus.NON_FINITE)
            lanes.write_out(f, self.table, ended)
            w.store(w.but_not(active, ended), f.active)
