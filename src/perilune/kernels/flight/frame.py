"""What the parts of a flight share while its machine code is written: kernels, table, buffers.

`driver` writes the steps, `crossing` the events and `lanes` the way in and out; each works on a `Frame`.
"""

from __future__ import annotations

from perilune.kernels.algebra.program import Program, hoist, trace
from perilune.kernels.algebra.system import ArcSystem
from perilune.kernels.code.emit import kernel, library
from perilune.kernels.code.ir import INT, NUM, Int, Kind, Mask, Num, Ptr, T, Vec, Writer
from perilune.kernels.flight.arcs import TABLE, ArcStatus

# Stages 1 and 2 are not needed after stage 4, nor stage 3 for the end of the step: the last three take their
# memory. All that a step of four lanes touches should stay within a first cache of 32 KiB.
SLOT = {**{i: i for i in range(10)}, 10: 1, 11: 2, 12: 3}


# Up to so many modes the choice of the field is written out at every use; of more it is a function.
_FEW = 4


class Kernels:
    """The functions of a system as IR: what depends on the parameters alone, once, and the rest."""

    def __init__(self, system: ArcSystem, width: int) -> None:
        self.width = width
        self.once: list[tuple[str, int]] = []  # kernels of the parameters, and where their values go
        self.held: dict[str, int] = {}  # kernel: where the values it needs of them begin
        self.constants = 0  # how many values in all
        self._functions: list[str] = []
        self._programs: list[Program] = []
        self.modes, self._size = len(system.modes), system.size
        for mode in range(self.modes):
            self._add(f"field{mode}", system.field_program(mode), (0,), 1)
        if system.events:
            self._add("crossings", trace(system.crossings()), (0, 1, 2), 3)
            for event, before in system.carried:
                program = trace(system.transition(event, before))
                self._add(f"transition{event}_{before}", program, (0,), 1)

    def _add(self, name: str, program: Program, arguments: tuple[int, ...], parameters: int) -> None:
        before, during = hoist(program, parameters)
        self._functions.append(kernel(f"{name}.once", before, (parameters,), self.width))
        self._functions.append(kernel(name, during, (*arguments, parameters), self.width))
        self._programs += [before, during]
        self.once.append((f"{name}.once", self.constants))
        self.held[name] = self.constants
        self.constants += max(len(before.outputs), 1)

    def text(self) -> str:
        """Return the IR of the kernels and of what they call."""
        fields = [self._fields()] if self.modes > _FEW else []
        return "\n".join([library(self._programs, self.width), *self._functions, *fields])

    def call(self, w: Writer, constants: Ptr[Vec], name: str, *pointers: Ptr[Vec]) -> None:
        """Call a kernel: its buffers, the values it needs of the parameters, its result last."""
        *inputs, result = pointers
        held = w.at(constants, self.held[name])
        w.run(f"call void @{name}({', '.join(f'ptr {x}' for x in (*inputs, held, result))})")

    def field(self, w: Writer, constants: Ptr[Vec], mode: Ptr[Vec], state: Ptr[Vec], *into: Ptr[Vec]) -> None:
        """Y' of each lane in its mode, `into` a spare buffer and the result.

        Where all lanes share a mode, as mostly they do, nothing is blended.
        """
        spare, result = into
        here = w.load(mode)
        for number in range(self.modes):
            mine = w.compare("oeq", here, w.const(float(number)))
            elsewhere = w.any(w.opposite(mine))
            with w.when(w.not_bit(elsewhere)):
                self.call(w, constants, f"field{number}", state, result)
            with w.when(w.and_bit(w.any(mine), elsewhere)):
                self.call(w, constants, f"field{number}", state, spare)
                blend(w, mine, spare, result, self._size)

    def _fields(self) -> str:
        """The choice of the field as a function ``fields(constants, mode, state, spare, result)``."""
        w = Writer(self.width)
        buffers = [Ptr(f"%{name}", w.vector) for name in ("constants", "mode", "state", "spare", "result")]
        self.field(w, *buffers)
        taken = ", ".join(f"ptr {buffer}" for buffer in buffers)
        return f"define internal void @fields({taken}) nounwind noinline {{\n{w.body()}\n  ret void\n}}\n"


def blend(w: Writer, mask: Mask, source: Ptr[Vec], target: Ptr[Vec], count: int) -> None:
    """Copy vectors in the lanes of a mask."""
    with w.loop(0, count) as c:
        # Volatile, lest LLVM make a masked store of it, which some processors take ten times as long for.
        old = w.load(target, c, volatile=True)
        w.store(w.select(mask, w.load(source, c), old), target, c)


class Table:
    """What a call is handed, read in the order of `arcs.TABLE`: numbers, and where arrays of doubles lie."""

    def __init__(self, w: Writer) -> None:
        table = Ptr("%table", INT)

        def number(name: str) -> Int:
            return w.load(table, TABLE.index(name))

        def array(name: str, kind: Kind[T]) -> Ptr[T]:
            return w.address(table, TABLE.index(name), kind)

        self.lanes = number("lanes")
        self.order = array("order", INT)
        self.z0 = array("z0", NUM)
        self.p = array("p", NUM)
        self.p_stride = number("p_stride")
        self.duration = array("duration", NUM)
        self.seeds = array("seeds", NUM)
        self.rtol = array("rtol", NUM)
        self.atol = array("atol", NUM)
        self.mode = array("mode", NUM)
        self.max_steps = number("max_steps")
        self.fixed_steps = number("fixed_steps")
        self.z = array("z", NUM)
        self.rates = array("rates", NUM)
        self.columns = array("columns", NUM)
        self.info = array("info", NUM)
        self.log = array("log", NUM)
        self.nodes = array("nodes", NUM)


class Frame:
    """The buffers of one function in the writing, and calls of the kernels on them."""

    def __init__(self, system: ArcSystem, kernels: Kernels) -> None:
        self.system, self.kernels, self.width = system, kernels, kernels.width
        self.nz, self.n = system.nz, system.size
        w = self.w = Writer(self.width)
        # Vectors of length Y: the state, a stage's argument and in the end that of the step, a mode's slopes.
        self.state, self.new, self.spare = w.buffer(self.n), w.buffer(self.n), w.buffer(self.n)
        self.slopes = w.buffer((max(SLOT.values()) + 1) * self.n)  # of the stages
        self.slopes_after = w.at(self.slopes, SLOT[12] * self.n)  # at the end of the step
        self.parameters, self.constants = w.buffer(system.np), w.buffer(kernels.constants)
        # One number in each lane.
        self.time, self.duration, self.h, self.h_before = (w.buffer(1) for _ in range(4))
        self.root_before, self.limit, self.refused = (w.buffer(1) for _ in range(3))
        self.steps, self.tries, self.mode, self.status = (w.buffer(1) for _ in range(4))
        self.events, self.rtol, self.atol = (w.buffer(1) for _ in range(3))
        self.active = w.allocate(w.mask, 1)
        # Vectors on their way from and to single lanes, and which lane of the batch each is.
        self.element, self.lane = w.buffer(16), w.allocate(INT, w.width)

    def call(self, name: str, *pointers: Ptr[Vec]) -> None:
        """Call a kernel with its buffers, its result last."""
        self.kernels.call(self.w, self.constants, name, *pointers)

    def field(self, state: Ptr[Vec], result: Ptr[Vec]) -> None:
        """Y' of each lane in its mode."""
        buffers = self.constants, self.mode, state, self.spare, result
        if self.kernels.modes == 1:
            self.call("field0", state, result)
        elif self.kernels.modes <= _FEW:
            self.kernels.field(self.w, *buffers)
        else:
            self.w.run(f"call void @fields({', '.join(f'ptr {buffer}' for buffer in buffers)})")

    def blend(self, mask: Mask, source: Ptr[Vec], target: Ptr[Vec], count: int) -> None:
        """Copy vectors in the lanes of a mask."""
        blend(self.w, mask, source, target, count)

    def fill_constants(self) -> None:
        """Evaluate what depends on the parameters alone."""
        for name, place in self.kernels.once:
            self.w.run(f"call void @{name}(ptr {self.parameters}, ptr {self.w.at(self.constants, place)})")

    def mark(self, mask: Mask, status: ArcStatus) -> None:
        """Note how the lanes of a mask end."""
        w = self.w
        w.store(w.select(mask, w.const(float(status)), w.load(self.status)), self.status)

    def elements(self) -> Ptr[Num]:
        """Return `element` lane by lane."""
        return self.w.by_lane(self.element)
