"""Adaptive DOP853 for groups of lanes, as LLVM IR: the whole stepping loop is machine code.

The lanes of a group step together, each with its own step, error, acceptance and end; a lane that has ended
takes steps of length zero until its group is done. The error of z alone sets the step (the scaled norm of
Hairer's code); the columns S ride along, and because their stages solve the exact derivative of the discrete
steps they are the derivative of what was computed, to the order of the method. Values that are not finite
make the error NaN: the step is refused and shortened, and where no shorter step helps the lane ends as
NON_FINITE.

Source: Hairer, Norsett, Wanner, *Solving ODEs I*, section II.4 (initial step, step control) and II.10
(DOP853); Hairer & Wanner, *Solving ODEs II*, section IV.8 (Gustafsson's predictive controller, of which only the
caution is taken: it refuses fewer steps where the error grows from step to step).
"""

from __future__ import annotations

from collections.abc import Callable

from perilune.kernels.algebra.program import Program, hoist, trace
from perilune.kernels.algebra.system import ArcSystem
from perilune.kernels.code.emit import kernel, library
from perilune.kernels.code.ir import Writer
from perilune.kernels.flight import crossing, lanes, tableau
from perilune.kernels.flight.arcs import TABLE, ArcStatus

# Stages 1 and 2 are not needed after stage 4, nor stage 3 for the end of the step: the last three take their
# memory. All that a step of four lanes touches should stay within a first cache of 32 KiB.
_SLOT = {**{i: i for i in range(10)}, 10: 1, 11: 2, 12: 3}
_SAFETY, _SHRINK, _GROW = 0.9, 0.2, 10.0
# Hairer's first step is for any order: with order 8 its error was found 1e-6 to 1e-5 of what is allowed.
_FIRST = 3.0
_LEAST = 0.01**0.125  # an error below 0.01 says little of the trend
# What a lane has one number of, each a buffer and an attribute of the driver.
_EACH_LANE = (
    *("time", "duration", "h", "h_before", "root_before", "limit", "refused"),
    *("steps", "tries", "mode", "status", "events", "rtol", "atol"),
)
_RESOLVED = 1e-14  # a step below this fraction of the duration is not taken


class Driver:
    """Writes the module of one system for one number of lanes.

    The attributes below are names of buffers in the function being written.
    """

    w: Writer
    table: dict[str, str]
    fixed: str
    # vectors of length Y: the state, a stage's argument and in the end that of the step, a mode's slopes
    state: str
    new: str
    spare: str
    # the slopes of the stages, and those at the end of the step
    slopes: str
    slopes_after: str
    # one vector each
    time: str
    duration: str
    h: str
    h_before: str
    root_before: str
    limit: str
    refused: str
    steps: str
    tries: str
    mode: str
    status: str
    events: str
    rtol: str
    atol: str
    # of the events
    g_old: str
    g_new: str
    g_after: str
    fired: str
    crossed: str

    def __init__(self, system: ArcSystem, width: int) -> None:
        self.system, self.width = system, width
        self.nz, self.n = system.nz, system.size
        self.functions: list[str] = []
        self.programs: list[Program] = []
        self.once: list[tuple[str, int]] = []  # kernels of the parameters, and where their values go
        self.held: dict[str, int] = {}  # kernel: where the values it needs of them begin
        self._constants = 0
        for mode in range(len(system.modes)):
            self._add(f"field{mode}", system.field_program(mode), (0,), 1)
        if system.events:
            self._add("crossings", trace(system.crossings()), (0, 1), 2)
            for event, before, _ in system.transitions:
                program = trace(system.transition(event, before))
                self._add(f"transition{event}_{before}", program, (0,), 1)

    def _add(self, name: str, program: Program, arguments: tuple[int, ...], parameters: int) -> None:
        before, during = hoist(program, parameters)
        self.functions.append(kernel(f"{name}.once", before, (parameters,), self.width))
        self.functions.append(kernel(name, during, (*arguments, parameters), self.width))
        self.programs += [before, during]
        self.once.append((f"{name}.once", self._constants))
        self.held[name] = self._constants
        self._constants += max(len(before.outputs), 1)

    def module(self) -> str:
        """Return the IR of ``void arcs(i64 first group, i64 last group, ptr table)`` and of ``rates``."""
        offsets = ", ".join(f"i64 {x}" for x in self.system.offsets)
        values = f"[{offsets}]" if offsets else "zeroinitializer"
        constant = f"@offsets = internal constant [{len(self.system.offsets)} x i64] {values}\n"
        return "\n".join([constant, library(self.programs, self.width), *self.functions, self._arcs(), self._rates()])

    # -- calls of kernels
    # ----------------------------------------------------------------------------------------
    def call(self, name: str, *pointers: str) -> None:
        """Call a kernel: its buffers, the values it needs of the parameters, its result last."""
        *inputs, result = pointers
        held = self.w.at(self.constants, self.held[name])
        self.w.run(f"call void @{name}({', '.join(f'ptr {x}' for x in (*inputs, held, result))})")

    def field(self, state: str, result: str) -> None:
        """Y' of each lane in its mode; where all lanes share it, as mostly they do, nothing is blended."""
        if len(self.system.modes) == 1:
            self.call("field0", state, result)
            return
        w, mode = self.w, self.w.load(self.mode)
        for number in range(len(self.system.modes)):
            here = w.compare("oeq", mode, w.const(float(number)))
            elsewhere = w.any(self._not(here))
            with w.when(w.let(f"xor i1 {elsewhere}, true")):
                self.call(f"field{number}", state, result)
            with w.when(w.let(f"and i1 {w.any(here)}, {elsewhere}")):
                self.call(f"field{number}", state, self.spare)
                self.blend(here, self.spare, result, self.n)

    def blend(self, mask: str, source: str, target: str, count: int) -> None:
        """Copy vectors in the lanes of a mask."""
        w = self.w
        with w.loop(0, count) as c:
            # Volatile, lest LLVM make a masked store of it, which some processors take ten times as long for.
            old = w.let(f"load volatile {w.vector}, ptr {w.at(target, c)}, align {w.align(w.vector)}")
            w.store(w.select(mask, w.load(source, c), old), target, c)

    def fill_constants(self) -> None:
        """Evaluate what depends on the parameters alone."""
        for name, place in self.once:
            self.w.run(f"call void @{name}(ptr {self.parameters}, ptr {self.w.at(self.constants, place)})")

    # -- the function
    # --------------------------------------------------------------------------------------------
    def _open(self) -> Writer:
        w = self.w = Writer(self.width)
        for name in ("state", "new", "spare"):
            setattr(self, name, w.buffer(self.n))
        self.slopes = w.buffer((max(_SLOT.values()) + 1) * self.n)
        self.slopes_after = w.at(self.slopes, _SLOT[12] * self.n)
        self.parameters = w.buffer(self.system.np)
        self.constants = w.buffer(self._constants)
        for name in _EACH_LANE:
            setattr(self, name, w.buffer(1))
        self.active, self.ended = w.buffer(1, w.mask), w.buffer(1, w.mask)
        self.element, self.lane = w.buffer(16), w.buffer(w.width, "i64")
        crossing.allocate(self)
        return w

    def _arcs(self) -> str:
        w = self._open()
        integers = {"lanes", "p_stride", "max_steps", "fixed_steps"}
        self.table = {name: w.load("%table", k, "i64" if name in integers else "ptr") for k, name in enumerate(TABLE)}
        self.fixed = w.let(f"icmp sgt i64 {self.table['fixed_steps']}, 0")
        with w.loop("%first", "%last") as group:
            lanes.gather(self, group)
            self.fill_constants()
            self.field(self.state, self.slopes)
            self._first_step()
            crossing.begin(self)
            with w.repeat_while_any(self.active):
                self._step()
        return f"define void @arcs(i64 %first, i64 %last, ptr %table) nounwind {{\n{w.body()}\n  ret void\n}}\n"

    def _rates(self) -> str:
        """Write ``rates(count, Y, p, modes, result)``: Y' at many points with one p, for the dense output."""
        if self.width != 1:
            return ""
        w = self._open()
        with w.loop(0, self.system.np) as c:
            w.store(w.load("%p", c), self.parameters, c)
        self.fill_constants()
        with w.loop(0, "%count") as k:
            w.store(w.load("%modes", k), self.mode)
            row = w.let(f"mul i64 {k}, {self.n}")
            self.field(w.at("%y", row), w.at("%out", row))
        return (
            f"define void @rates(i64 %count, ptr %y, ptr %p, ptr %modes, ptr %out) nounwind {{\n"
            f"{w.body()}\n  ret void\n}}\n"
        )

    # -- the initial step
    # ----------------------------------------------------------------------------------------
    def _norm(self, value: Callable[[str], str]) -> str:
        """Root mean square of value(c) over z, scaled by the tolerance at the start."""
        w = self.w
        total = w.buffer(1)
        w.store(w.const(0.0), total)
        with w.loop(0, self.nz) as c:
            size = w.intrinsic("fabs", w.load(self.state, c))
            scale = w.fma(w.load(self.rtol), size, w.load(self.atol))
            x = w.div(value(c), scale)
            w.store(w.fma(x, x, w.load(total)), total)
        return w.intrinsic("sqrt", w.mul(w.load(total), w.const(1 / self.nz)))

    def _first_step(self) -> None:
        """Hairer's initial step from the sizes of z, z' and an estimate of z''."""
        w = self.w
        duration = w.load(self.duration)
        length = w.intrinsic("fabs", duration)
        d0 = self._norm(lambda c: w.load(self.state, c))
        d1 = self._norm(lambda c: w.load(self.slopes, c))
        small = w.either(w.compare("olt", d0, w.const(1e-5)), w.compare("olt", d1, w.const(1e-5)))
        h0 = w.select(small, w.const(1e-6), w.mul(w.const(0.01), w.div(d0, d1)))
        h0 = w.smaller(h0, length)
        signed = w.intrinsic("copysign", h0, duration)
        with w.loop(0, self.n) as c:
            w.store(w.fma(signed, w.load(self.slopes, c), w.load(self.state, c)), self.new, c)
        self.field(self.new, self.slopes_after)
        d2 = w.div(self._norm(lambda c: w.sub(w.load(self.slopes_after, c), w.load(self.slopes, c))), h0)
        d = w.larger(d2, d1)
        root = w.div(w.const(0.01), d)
        for _ in range(3):
            root = w.intrinsic("sqrt", root)
        tiny = w.larger(w.const(1e-6), w.mul(h0, w.const(1e-3)))
        h1 = w.select(w.compare("ole", d, w.const(1e-15)), tiny, w.mul(w.const(_FIRST), root))
        h = w.smaller(w.smaller(h1, w.mul(h0, w.const(100.0))), length)
        each = w.div(length, self._broadcast(self.table["fixed_steps"]))
        h = w.let(f"select i1 {self.fixed}, {w.vector} {each}, {w.vector} {h}")
        w.store(h, self.h)
        w.store(w.const(float("inf")), self.limit)
        w.store(w.const(0.0), self.h_before)  # there is no trend yet
        w.store(w.const(1.0), self.root_before)

    def _broadcast(self, integer: str) -> str:
        w = self.w
        value = w.let(f"sitofp i64 {integer} to double")
        result = "poison"
        for lane in range(self.width):
            result = w.let(f"insertelement {w.vector} {result}, double {value}, i32 {lane}")
        return result

    # -- one step
    # --------------------------------------------------------------------------------------------------
    def _step(self) -> None:
        w = self.w
        active = w.load(self.active, kind=w.mask)
        duration, time = w.load(self.duration), w.load(self.time)
        remaining = w.sub(duration, time)
        limited = w.compare("olt", w.load(self.limit), w.load(self.h))  # cut short to meet an event
        wanted = w.smaller(w.load(self.h), w.load(self.limit))
        last = w.compare("oge", w.mul(wanted, w.const(1 + 1e-10)), w.intrinsic("fabs", remaining))
        h = w.select(last, remaining, w.intrinsic("copysign", wanted, duration))
        h = w.select(active, h, w.const(0.0))
        self._stages(h)
        error = self._error(h)
        finite = w.compare("ord", error, error)
        good = w.let(f"select i1 {self.fixed}, {w.mask} {finite}, {w.mask} {w.compare('ole', error, w.const(1.0))}")
        accepted = w.both(active, good)
        w.store(w.add(w.load(self.tries), w.const(1.0)), self.tries)
        held = w.buffer(1, w.mask)
        w.store(accepted, held, kind=w.mask)
        with w.when(w.any(accepted)):
            self._finish_step(h)
            crossing.locate(self, h, held)
        accepted = w.load(held, kind=w.mask)
        self._adapt(h, error, active, good, limited)
        self._commit(h, accepted, last)
        self._end(error, accepted, active, last)

    def _stages(self, h: str) -> None:
        w = self.w
        for stage in range(1, tableau.STAGES):
            with w.loop(0, self.n) as c:
                w.store(w.fma(h, self._combine(tableau.A[stage], c), w.load(self.state, c)), self.new, c)
            self.field(self.new, w.at(self.slopes, _SLOT[stage] * self.n))

    def _combine(self, weights: dict[int, float], c: str) -> str:
        """Sum the slopes of an entry with the weights of a row of the tableau."""
        w, total = self.w, ""
        for stage, weight in weights.items():
            slope = w.load(w.at(self.slopes, _SLOT[stage] * self.n), c)
            factor = w.const(weight)
            total = w.fma(slope, factor, total) if total else w.mul(slope, factor)
        return total

    def _error(self, h: str) -> str:
        """Advance z into `new`; returns the scaled error, NaN if anything in it is not finite."""
        w = self.w
        fifth, third = w.buffer(1), w.buffer(1)
        w.store(w.const(0.0), fifth)
        w.store(w.const(0.0), third)
        with w.loop(0, self.nz) as c:
            old = w.load(self.state, c)
            new = w.fma(h, self._combine(tableau.B, c), old)
            w.store(new, self.new, c)
            size = w.larger(w.intrinsic("fabs", old), w.intrinsic("fabs", new))
            scale = w.fma(w.load(self.rtol), size, w.load(self.atol))
            inverse = w.div(w.const(1.0), scale)
            for weights, total in ((tableau.E5, fifth), (tableau.E3, third)):
                x = w.mul(self._combine(weights, c), inverse)
                w.store(w.fma(x, x, w.load(total)), total)
        e5, e3 = w.load(fifth), w.load(third)
        both = w.mul(w.fma(w.const(0.01), e3, e5), w.const(float(self.nz)))
        bottom = w.larger(w.intrinsic("sqrt", both), w.const(1e-300))
        return w.div(w.mul(w.intrinsic("fabs", h), e5), bottom)

    def _finish_step(self, h: str) -> None:
        """Advance the columns, and the slopes at the end, which are the first of the next step."""
        w = self.w
        with w.loop(self.nz, self.n) as c:
            w.store(w.fma(h, self._combine(tableau.B, c), w.load(self.state, c)), self.new, c)
        self.field(self.new, self.slopes_after)

    def _adapt(self, h: str, error: str, active: str, good: str, limited: str) -> None:
        """Set the next step: err^(-1/8), held back after a refusal or by a trend, untouched by a step cut short."""
        w = self.w
        root, size = error, w.intrinsic("fabs", h)
        for _ in range(3):
            root = w.intrinsic("sqrt", root)
        inverse = w.div(w.const(1.0), root)
        before = w.mul(w.load(self.root_before), w.div(size, w.load(self.h_before)))
        trend = w.smaller(w.mul(before, inverse), w.const(1.0))
        factor = w.mul(w.mul(w.const(_SAFETY), inverse), w.select(good, trend, w.const(1.0)))
        usual = w.but_not(good, limited)
        w.store(w.select(usual, size, w.load(self.h_before)), self.h_before)
        w.store(w.select(usual, w.larger(root, w.const(_LEAST)), w.load(self.root_before)), self.root_before)
        factor = w.smaller(w.larger(factor, w.const(_SHRINK)), w.const(_GROW))
        refused = w.compare("ogt", w.load(self.refused), w.const(0.0))
        factor = w.select(w.either(refused, self._not(good)), w.smaller(factor, w.const(1.0)), factor)
        old = w.load(self.h)
        new = w.mul(size, factor)
        new = w.select(w.both(limited, good), old, new)
        new = w.let(f"select i1 {self.fixed}, {w.vector} {old}, {w.vector} {new}")
        w.store(w.select(active, new, old), self.h)
        w.store(w.select(good, w.const(0.0), w.const(1.0)), self.refused)

    def _not(self, mask: str) -> str:
        return self.w.let(f"xor {self.w.mask} {mask}, splat (i1 true)")

    def _commit(self, h: str, accepted: str, last: str) -> None:
        w = self.w
        time = w.load(self.time)
        if self.width == 1:
            self._record(h, accepted, time)
        end = w.select(last, w.load(self.duration), w.add(time, h))
        w.store(w.select(accepted, end, time), self.time)
        w.store(w.add(w.load(self.steps), w.select(accepted, w.const(1.0), w.const(0.0))), self.steps)
        with w.when(w.any(accepted)):
            self.blend(accepted, self.new, self.state, self.n)
            self.blend(accepted, self.slopes_after, self.slopes, self.n)

    def _record(self, h: str, accepted: str, time: str) -> None:
        """Note the start of an accepted step (time, length, mode, z), where nodes are asked for."""
        w, nodes = self.w, self.table["nodes"]
        wanted = w.let(f"icmp ne ptr {nodes}, null")
        with w.when(w.let(f"and i1 {wanted}, {w.any(accepted)}")):
            row = w.let(f"fptosi double {w.let(f'extractelement {w.vector} {w.load(self.steps)}, i32 0')} to i64")
            base = w.at(nodes, w.let(f"mul i64 {row}, {3 + self.nz}"), "double")
            for place, value in enumerate((time, h, w.load(self.mode))):
                w.store(value, base, place)
            with w.loop(0, self.nz) as c:
                w.store(w.load(self.state, c), w.at(base, 3), c)

    # -- the ends
    # --------------------------------------------------------------------------------------------------
    def _end(self, error: str, accepted: str, active: str, last: str) -> None:
        w = self.w
        w.store(w.const(-1.0), self.status)
        h, length = w.load(self.h), w.intrinsic("fabs", w.load(self.duration))
        nan = w.compare("uno", error, error)
        finest = w.mul(length, w.const(_RESOLVED))
        stuck = w.both(active, w.compare("ult", h, finest))
        lost = w.both(w.both(active, nan), w.let(f"select i1 {self.fixed}, {w.mask} {nan}, {w.mask} {stuck}"))
        spent = w.both(active, w.compare("oge", w.load(self.tries), self._broadcast(self.table["max_steps"])))
        self._mark(spent, ArcStatus.STEP_LIMIT)
        self._mark(stuck, ArcStatus.STALLED)
        self._mark(lost, ArcStatus.NON_FINITE)
        self._mark(w.both(accepted, last), ArcStatus.REACHED)
        crossing.fire(self)
        ended = w.both(active, w.compare("oge", w.load(self.status), w.const(0.0)))
        with w.when(w.any(ended)):
            total = w.buffer(1)
            w.store(w.const(0.0), total)
            with w.loop(0, self.n) as c:  # 0 x is NaN for what is not finite
                w.store(w.fma(w.load(self.state, c), w.const(0.0), w.load(total)), total)
            self._mark(w.both(ended, w.compare("uno", w.load(total), w.load(total))), ArcStatus.NON_FINITE)
            lanes.write_out(self, ended)
            w.store(w.but_not(active, ended), self.active, kind=w.mask)

    def _mark(self, mask: str, status: ArcStatus) -> None:
        w = self.w
        w.store(w.select(mask, w.const(float(status)), w.load(self.status)), self.status)

    mark = _mark
