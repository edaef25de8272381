"""Data shared by the writers of a flight's machine code: sizes, table, buffers, calls of the equations.

`driver` writes the steps, `event_location` the events and `lanes` the way in and out; each works on a `Frame`. Nothing
of it is known before it runs but how events are located, and where the numbers of the equations are.
"""

from __future__ import annotations

from perilune.kernels.algebra.system import ArcSystem
from perilune.kernels.code.ir import INT, NUM, Index, Int, Mask, Num, Ptr, T, ValueKind, Vec, Writer
from perilune.kernels.flight.records import EQUATIONS, TABLE, ArcStatus

# Stages 1 and 2 are not needed after stage 4, nor stage 3 for the end of the step: the last three take their
# memory. All that a step of four lanes reads and writes should stay within a first cache of 32 KiB.
SLOT = {**{i: i for i in range(10)}, 10: 1, 11: 2, 12: 3}


def blend(w: Writer, mask: Mask, source: Ptr[Vec], target: Ptr[Vec], count: Index) -> None:
    """Copy vectors in the lanes of a mask.

    Parameters
    ----------
    w
        Writer of the function.
    mask
        Lanes to copy.
    source, target
        Addresses of the first vector.
    count
        Number of vectors.
    """
    with w.loop(0, count) as c:
        # Volatile, lest LLVM make a masked store of it, which some processors take ten times as long for.
        old = w.load(target, c, volatile=True)
        w.store(w.select(mask, w.load(source, c), old), target, c)


class CallTable:
    """The table that a call takes, in the order of `records.TABLE`: numbers, and addresses of arrays of doubles."""

    def __init__(self, w: Writer) -> None:
        table = Ptr("%table", INT)

        def number(name: str) -> Int:
            return w.load(table, TABLE.index(name))

        def array(name: str, kind: ValueKind[T]) -> Ptr[T]:
            return w.address(table, TABLE.index(name), kind)

        self.equations = array("equations", INT)
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
    """The buffers of one function in the writing, and calls of the equations on them."""

    def __init__(self, system: ArcSystem, w: Writer, equations: Ptr[Int]) -> None:
        self.system, self.w, self.width, self._equations = system, w, w.width, equations
        self.nz, self.n, self.np, self.nc = (w.load(equations, EQUATIONS.index(x)) for x in ("nz", "n", "np", "nc"))
        self.kept = w.integer("sub", self.n, self.nz)  # entries of S
        self.offsets = w.address(equations, EQUATIONS.index("offsets"), INT)
        # Vectors of length Y: the state, a stage's argument and in the end that of the step, a mode's slopes.
        self.state, self.new, self.spare = (w.several(w.vector, self.n) for _ in range(3))
        slopes = w.several(w.vector, w.integer("mul", self.n, max(SLOT.values()) + 1))
        rows = [w.at(slopes, w.integer("mul", self.n, slot)) for slot in range(max(SLOT.values()) + 1)]
        self.slopes = [rows[SLOT[stage]] for stage in sorted(SLOT)]  # of the stages, the last at the end of the step
        self.parameters = w.several(w.vector, self.np)
        self.constants = w.several(w.vector, w.load(equations, EQUATIONS.index("constants")))
        # One number in each lane.
        self.time, self.duration, self.h, self.h_before = (w.buffer(1) for _ in range(4))
        self.root_before, self.limit, self.refused = (w.buffer(1) for _ in range(3))
        self.steps, self.tries, self.mode, self.status = (w.buffer(1) for _ in range(4))
        self.events, self.rtol, self.atol = (w.buffer(1) for _ in range(3))
        self.active = w.allocate(w.mask, 1)
        # Vectors on their way from and to single lanes, and which lane of the batch each is.
        self.element, self.lane = w.buffer(16), w.allocate(INT, w.width)

    def _call(self, place: int, *pointers: Ptr[Vec]) -> None:
        function = self.w.address(self._equations, place, self.w.vector)
        self.w.run(f"call void {function}({', '.join(f'ptr {x}' for x in pointers)})")

    def fill_constants(self) -> None:
        """Evaluate what depends only on the parameters."""
        self._call(EQUATIONS.index("fill"), self.parameters, self.constants)

    def field(self, state: Ptr[Vec], result: Ptr[Vec]) -> None:
        """Evaluate Y' of each lane in its mode.

        Parameters
        ----------
        state
            Y = (z, kept entries of S), a vector of lanes for each number.
        result
            Buffer for Y', as long as Y.
        """
        self._call(EQUATIONS.index("field"), self.constants, self.mode, state, self.spare, result)

    def crossings(self, state: Ptr[Vec], rates: Ptr[Vec], result: Ptr[Vec]) -> None:
        """Evaluate (g, g') of all events.

        Parameters
        ----------
        state, rates
            z and z', a vector of lanes for each of the nz components.
        result
            Buffer for g of all events and then g', 2 vectors for each event.
        """
        self._call(EQUATIONS.index("crossings"), self.constants, state, rates, self.mode, result)

    def carry(self, event: int, before: int, state: Ptr[Vec], result: Ptr[Vec]) -> None:
        """Evaluate Y after an event, one of those that change it.

        Parameters
        ----------
        event
            Index of the event in the system.
        before
            Mode of the dynamics before the event.
        state
            Y at the event, a vector of lanes for each number.
        result
            Buffer for Y after it, as long as Y.
        """
        place = len(EQUATIONS) + self.system.carried.index((event, before))
        self._call(place, self.constants, state, result)

    def blend(self, mask: Mask, source: Ptr[Vec], target: Ptr[Vec], count: Index) -> None:
        """Copy vectors in the lanes of a mask.

        Parameters
        ----------
        mask
            Lanes that are copied; the others of the target stay.
        source, target
            Buffers of vectors.
        count
            Number of vectors to copy.
        """
        blend(self.w, mask, source, target, count)

    def mark(self, mask: Mask, status: ArcStatus) -> None:
        """Note how the lanes of a mask end.

        Parameters
        ----------
        mask
            Lanes that end.
        status
            The way in which they end.
        """
        w = self.w
        w.store(w.select(mask, w.const(float(status)), w.load(self.status)), self.status)

    def elements(self) -> Ptr[Num]:
        """Return `element` lane by lane."""
        return self.w.by_lane(self.element)
