"""Event location inside the stepping loop, by step control, as LLVM IR.

After each step the event functions g and their rates g' = dg/dz z' are evaluated at its end. A crossing
refuses the step and asks for one that ends at the zero of the cubic Hermite polynomial of g over the step; a
step that ends short of the zero is kept and the next aims at it by Newton's method. So the zero is approached
by whole DOP853 steps, with the accuracy of the arc itself (the interpolant of order 7 would lose some), the
columns come along, and the event fires where |g/g'| is below `TOLERANCE` of the duration. Two crossings
inside one step are looked for where the cubic dips through zero, or so near to it that it may err: the step then ends
there, and shorter ones decide.

After an event the field, the events and (by `ArcSystem.transition`) state and columns are those of the new
mode.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from perilune.kernels.algebra.system import Event
from perilune.kernels.code.ir import BIT, INT, Mask, Num, Ptr, Vec, Writer
from perilune.kernels.flight.codegen_context import CallTable, Frame
from perilune.kernels.flight.records import MAX_EVENTS, ArcStatus

#: How near to the zero, as a fraction of the duration, an event fires.
TOLERANCE = 1e-13
_AFTER = 1e-150  # stands for "just beyond zero": the sign of g after its own event; products of it stay finite
_DOUBTED = 0.03  # of g at the ends: so near to zero a cubic over a long step may err in whether it dips through
_SHORT = 1e4  # times that: a step in which g changes by its rounding only, if at all
_BISECTIONS = 20  # after them Newton has two steps to the last digit
# A refused step becomes shorter at least by this: where a flight grazes its zero, g beyond it is rounding for a while.
_WHOLE = 1.0 - 1e-5


class EventCrossings:
    """The events of one function in the writing: g and g' at the start and at the end of a step, and which fire."""

    def __init__(self, frame: Frame) -> None:
        w, count = frame.w, len(frame.system.events)
        self.f, self.w, self.count = frame, w, count
        self.old, self.new, self.after = (w.buffer(2 * count) for _ in range(3))
        self.fired, self.crossed = w.allocate(w.mask, count), w.allocate(w.mask, count)
        self.aimed = w.allocate(w.mask, 1)

    def begin(self) -> None:
        """Evaluate the events at the start."""
        f, w = self.f, self.w
        f.crossings(f.state, f.slopes[0], self.old)
        for number in range(self.count):
            w.store(self._just_after(self.old, number), self.old, number)
            w.store(w.const_mask(False), self.fired, number)

    def _just_after(self, values: Ptr[Vec], number: int) -> Vec:
        """Return g of an event; where it is 0, the sign it is about to have."""
        w, g = self.w, self.w.load(values, number)
        sign = w.intrinsic("copysign", w.const(_AFTER), w.load(values, self.count + number))
        return w.select(w.compare("oeq", g, w.const(0.0)), sign, g)

    def locate(self, h: Vec, held: Ptr[Mask]) -> None:
        """Look for crossings in an accepted step; where there are, refuse it or let the event fire at its end.

        Parameters
        ----------
        h
            Length of the step in each lane, with its sign, in the unit of time of the system.
        held
            Buffer of one mask: lanes whose step is accepted; those that an event refuses are taken out.
        """
        f, w, count = self.f, self.w, self.count
        f.crossings(f.new, f.slopes[-1], self.new)
        accepted = w.load(held)
        theta, ahead = w.buffer(1), w.buffer(1)
        w.store(w.const(2.0), theta)
        w.store(w.const(math.inf), ahead)
        resolution = w.mul(w.intrinsic("fabs", w.load(f.duration)), w.const(TOLERANCE))
        for number, event in enumerate(f.system.events):
            watched = w.both(accepted, self._watched(event))
            self._examine(number, event, h, watched, resolution, theta, ahead)
        early = w.both(accepted, w.compare("olt", w.load(theta), w.const(1.5)))
        done = w.const_mask(False)
        for number in range(count):
            fires = w.but_not(w.but_not(w.load(self.fired, number), early), done)
            w.store(fires, self.fired, number)
            done = w.either(done, fires)
        kept = w.but_not(accepted, early)
        w.store(kept, held)
        limit = w.load(f.limit)
        approaching = w.both(w.but_not(kept, done), w.compare("olt", limit, w.const(math.inf)))
        after = w.select(approaching, w.load(ahead), w.select(kept, w.const(math.inf), limit))
        w.store(w.select(early, w.mul(w.load(theta), w.intrinsic("fabs", h)), after), f.limit)
        with w.loop(0, 2 * count) as c:
            w.store(w.select(w.but_not(kept, done), w.load(self.new, c), w.load(self.old, c)), self.old, c)

    def _watched(self, event: Event) -> Mask:
        f, w, mask = self.f, self.w, self.w.const_mask(False)
        for mode in range(len(f.system.modes)):
            if event.watched(mode):
                mask = w.either(mask, w.compare("oeq", w.load(f.mode), w.const(float(mode))))
        return mask

    def _examine(
        self, number: int, event: Event, h: Vec, watched: Mask, resolution: Vec, theta: Ptr[Vec], ahead: Ptr[Vec]
    ) -> None:
        w, count, zero = self.w, self.count, self.w.const(0.0)
        g0, g1 = w.load(self.old, number), w.load(self.new, number)
        rate0, rate1 = (w.mul(h, w.load(g, count + number)) for g in (self.old, self.new))  # over the step
        up, down = event.direction >= 0, event.direction <= 0
        rises = w.both(w.compare("olt", g0, zero), w.compare("oge", g1, zero)) if up else w.const_mask(False)
        falls = w.both(w.compare("ogt", g0, zero), w.compare("ole", g1, zero)) if down else w.const_mask(False)
        crosses = w.both(watched, w.either(rises, falls))
        to_rise = w.both(w.compare("olt", g1, zero), w.compare("ogt", rate1, zero)) if up else w.const_mask(False)
        to_fall = w.both(w.compare("ogt", g1, zero), w.compare("olt", rate1, zero)) if down else w.const_mask(False)
        heads = w.but_not(w.both(watched, w.either(to_rise, to_fall)), crosses)
        step = w.intrinsic("fabs", h)
        away = w.mul(step, w.intrinsic("fabs", w.div(g1, rate1)))
        near = w.either(w.compare("ole", away, resolution), w.compare("oeq", g1, zero))
        # Where g is as flat as near a double zero it is rounding before it is as near: no step lowers it any more.
        short = w.compare("ole", step, w.mul(resolution, w.const(_SHORT)))
        lower = w.compare("olt", w.intrinsic("fabs", g1), w.intrinsic("fabs", g0))
        left = w.compare(
            "ole", w.intrinsic("fabs", g0), w.const(_AFTER)
        )  # its own event a step ago: nothing was lowered
        rounding = w.but_not(short, w.either(lower, left))
        same_side = w.compare("ogt", w.mul(g0, g1), zero)  # not just left by its own event
        arrives = w.either(
            w.both(crosses, w.either(near, w.compare("ole", step, resolution))),
            w.both(w.both(heads, same_side), w.either(near, rounding)),
        )
        w.store(arrives, self.fired, number)
        w.store(crosses, self.crossed, number)
        nearer = w.smaller(away, w.load(ahead))
        w.store(w.select(heads, nearer, w.load(ahead)), ahead)
        inside = w.but_not(crosses, arrives)
        with w.when(w.any(inside)):
            self._aim("zero", inside, (g0, g1, rate0, rate1), theta)
        turns = w.both(w.compare("olt", w.mul(g0, rate0), zero), w.compare("ogt", w.mul(g1, rate1), zero))
        dips = w.both(w.but_not(watched, crosses), w.both(same_side, turns))
        with w.when(w.any(dips)):
            self._aim("dip", dips, (g0, g1, rate0, rate1), theta)

    def _aim(self, name: str, mask: Mask, ends: Iterable[Vec], theta: Ptr[Vec]) -> None:
        values = ", ".join(f"{self.w.vector} {x}" for x in ends)
        self.w.store(mask, self.aimed)
        self.w.run(f"call void @{name}(ptr {self.aimed}, {values}, ptr {theta})")

    def fire(self, t: CallTable) -> None:
        """Note the events at the end of the committed step, and end the arc or change its mode."""
        f, w = self.f, self.w
        masks = [w.load(self.fired, number) for number in range(self.count)]
        some = masks[0]
        for mask in masks[1:]:
            some = w.either(some, mask)
        with w.when(w.any(some)):
            for number, mask in enumerate(masks):
                self._log(t, number, mask)
            w.store(w.select(some, w.add(w.load(f.events), w.const(1.0)), w.load(f.events)), f.events)
            full = w.compare("oge", w.load(f.events), w.const(float(MAX_EVENTS)))
            f.mark(w.both(some, full), ArcStatus.STEP_LIMIT)
            for mask, event in zip(masks, f.system.events, strict=True):
                if event.terminal:
                    f.mark(mask, ArcStatus.EVENT)
            if f.system.transitions:
                self._transit(masks)
                f.field(f.state, f.new)
                f.blend(some, f.new, f.slopes[0], f.n)
            self._look_again(masks, some)
            w.store(w.select(some, w.const(math.inf), w.load(f.limit)), f.limit)
        for number in range(self.count):
            w.store(w.const_mask(False), self.fired, number)

    def _log(self, t: CallTable, number: int, mask: Mask) -> None:
        f, w = self.f, self.w
        with w.when(w.any(mask)):
            w.store(w.load(f.time), f.element, 0)
            w.store(w.load(f.events), f.element, 1)
            w.store(w.select(mask, w.const(1.0), w.const(0.0)), f.element, 2)
            with w.loop(0, f.width) as k:
                time, met, flag = (w.load(f.elements(), w.entry(i, f.width, k)) for i in range(3))
                room = w.let(BIT, f"fcmp olt double {met}, {float(MAX_EVENTS)}")
                with w.when(w.and_bit(room, w.positive(flag))):
                    row = w.integer("mul", w.load(f.lane, k), 2 * MAX_EVENTS)
                    place = w.integer("shl", w.let(INT, f"fptosi double {met} to i64"), 1)
                    entry = w.at(t.log, w.integer("add", row, place))
                    w.store(Num(float(number)), entry, 0)
                    w.store(time, entry, 1)

    def _transit(self, masks: list[Mask]) -> None:
        """Carry state, columns and mode over the events."""
        f, w, mode = self.f, self.w, self.w.load(self.f.mode)
        new_mode = mode
        for number, before, after in f.system.transitions:
            here = w.both(masks[number], w.compare("oeq", mode, w.const(float(before))))
            if not f.system.events[number].steady:
                with w.when(w.any(here)):
                    f.carry(number, before, f.state, f.new)
                    f.blend(here, f.new, f.state, f.n)
            new_mode = w.select(here, w.const(float(after)), new_mode)
        w.store(new_mode, f.mode)

    def _look_again(self, masks: list[Mask], some: Mask) -> None:
        """Evaluate the events after one: its own g counts as passed, one that crossed with it as ahead."""
        f, w, count = self.f, self.w, self.count
        f.crossings(f.state, f.slopes[0], self.after)
        for number, mask in enumerate(masks):
            old = w.load(self.old, number)
            pending = w.both(some, w.load(self.crossed, number))
            value = w.select(some, self._just_after(self.after, number), old)
            value = w.select(pending, w.intrinsic("copysign", w.const(_AFTER), old), value)
            if not f.system.events[number].levels:  # else its next level lies ahead
                value = w.select(mask, w.intrinsic("copysign", w.const(_AFTER), w.neg(old)), value)
            w.store(value, self.old, number)
            rate = w.load(self.after, count + number)
            w.store(w.select(some, rate, w.load(self.old, count + number)), self.old, count + number)


def crossing_searches(width: int) -> str:
    """Return the IR of what aims at a crossing inside of a step: ``zero``, and ``dip`` where there are two."""
    return _bisect_cubic("zero", Writer(width), derivative=False) + _bisect_cubic("dip", Writer(width), derivative=True)


def _bisect_cubic(name: str, w: Writer, *, derivative: bool) -> str:
    """Bisect the Hermite cubic for its zero, or its slope for a dip to zero; the earliest counts."""
    mask, theta = w.load(Ptr("%mask", w.mask)), Ptr("%theta", w.vector)
    g0, g1, rate0, rate1 = (Vec(f"%{x}") for x in ("g0", "g1", "rate0", "rate1"))
    jump = w.sub(g1, g0)
    c2 = w.sub(w.mul(w.const(3.0), jump), w.fma(w.const(2.0), rate0, rate1))
    c3 = w.sub(w.add(rate0, rate1), w.mul(w.const(2.0), jump))

    def cubic(x: Vec) -> Vec:
        return w.fma(w.fma(w.fma(c3, x, c2), x, rate0), x, g0)

    def slope(x: Vec) -> Vec:
        return w.fma(w.fma(w.mul(w.const(3.0), c3), x, w.mul(w.const(2.0), c2)), x, rate0)

    at = slope if derivative else cubic
    start = rate0 if derivative else g0
    low, high = w.buffer(1), w.buffer(1)
    w.store(w.const(0.0), low)
    w.store(w.const(1.0), high)
    with w.loop(0, _BISECTIONS):
        middle = w.mul(w.const(0.5), w.add(w.load(low), w.load(high)))
        before = w.compare("ogt", w.mul(at(middle), w.intrinsic("copysign", w.const(1.0), start)), w.const(0.0))
        w.store(w.select(before, middle, w.load(low)), low)
        w.store(w.select(before, w.load(high), middle), high)
    found = w.load(high)
    if not derivative:
        for _ in range(2):
            nearer = w.sub(found, w.div(cubic(found), slope(found)))
            within = w.both(w.compare("ogt", nearer, w.load(low)), w.compare("olt", nearer, w.load(high)))
            found = w.select(within, nearer, found)
    if derivative:
        size = w.larger(w.intrinsic("fabs", g0), w.intrinsic("fabs", g1))
        room = w.mul(cubic(found), w.intrinsic("copysign", w.const(1.0), g0))
        reaches = w.compare("olt", room, w.mul(size, w.const(_DOUBTED)))
        inner = w.both(w.compare("ogt", found, w.const(1e-9)), w.compare("olt", found, w.const(_WHOLE)))
        mask = w.both(mask, w.both(reaches, inner))
    found = w.smaller(w.larger(found, w.const(1e-3)), w.const(_WHOLE))
    earlier = w.both(mask, w.compare("olt", found, w.load(theta)))
    w.store(w.select(earlier, found, w.load(theta)), theta)
    taken = ", ".join(["ptr %mask", *(f"{w.vector} {x}" for x in (g0, g1, rate0, rate1)), "ptr %theta"])
    return f"define internal void @{name}({taken}) nounwind {{\n{w.body()}\n  ret void\n}}\n"
